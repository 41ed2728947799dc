"""What the timing of a graph needs and its delays do not change: worked out once and kept with the graph."""

import math
from collections.abc import Iterable
from fractions import Fraction

import numpy as np

from deepkoco.graph.delay import Delay, exact_fraction, exact_seconds
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.layout import Layout, layout_of
from deepkoco.graph.timing.rule_tables import Columns, Rules

NANO = 10**9
_FINEST = 10**13  # ticks per second: beyond, int64 would not hold a day
_KEY = "timing plan"
_KEPT = 8  # layouts for different numbers of steps


def plan_of(graph: Graph) -> "TimingPlan":
    """Return what every timing of this graph has in common; worked out once."""
    plan = graph.kept.get(_KEY)
    if plan is None:
        plan = graph.kept[_KEY] = TimingPlan(graph)
    return plan


class TimingPlan:
    """Rules, ticks and columns of one graph.

    Args:
        graph: does not change any more.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.channels = (*(n.name for n in graph.nodes), *(c.key for c in graph.connections))
        """Names of the delays: nodes (computation), then connections (communication)."""
        self.places = {key: place for place, key in enumerate(self.channels)}
        self.laws = [node.delay for node in graph.nodes] + [c.law for c in graph.connections]
        """The graph's own laws, channel by channel."""
        rate = {node.name: node.rate for node in graph.nodes}
        senders = [node.name for node in graph.nodes] + [c.sender for c in graph.connections]
        supervisor = rate[graph.supervisor]
        self.periods = {key: float(1 / rate[s]) for key, s in zip(self.channels, senders, strict=True)}
        first = {node.name: phase for node, phase in zip(graph.nodes, graph.phases, strict=True)}
        self.starts = {node.name: float(first[node.name]) for node in graph.nodes} | {
            c.key: float(first[c.sender] + exact_seconds(graph.node(c.sender).delay))
            for c in graph.connections
        }
        """Nominal time of the first draw of each channel [s]: a computation begins, a message is sent."""
        self.rates = {key: float(rate[s]) for key, s in zip(self.channels, senders, strict=True)}
        self.ratios = [float(rate[s] / supervisor) for s in senders]
        """Draws of each channel per supervisor step."""
        self.head = [math.ceil(graph.phases[graph.index[graph.supervisor]] * rate[s]) + 8 for s in senders]
        """Draws of each channel before the first supervisor step, with something to spare."""
        self.constant = all(law.constant for law in self.laws)
        exact = [node.rate.numerator for node in graph.nodes] + [p.denominator for p in graph.phases]
        self._exact = math.lcm(NANO, *exact, *_denominators(self.laws))
        self._rules: dict[int, Rules] = {}
        self._columns: dict[tuple[int, bytes], tuple[Layout, Columns]] = {}
        self._nominal: dict[tuple[int, int], np.ndarray] = {}
        self._own: dict[tuple[int, int], int] = {}
        self._mine = {id(law): place for place, law in enumerate(self.laws)}

    def resolution(self, laws: Iterable[Delay]) -> int:
        """Return ticks per second in which all rates, phases and constant delays are whole, if possible."""
        finest = math.lcm(self._exact, *_denominators(laws))
        if finest > _FINEST:
            finest = self._exact
        return finest if finest <= _FINEST else NANO

    def ticks_of(self, law: Delay, resolution: int) -> int:
        """Return the expected delay of a law [ticks]."""
        place = self._mine.get(id(law), -1), resolution
        if place[0] < 0:
            return round(exact_seconds(law) * resolution)
        if place not in self._own:
            self._own[place] = round(exact_seconds(law) * resolution)
        return self._own[place]

    def capacity(self, steps: int) -> np.ndarray:
        """Return for how many steps of every node there is room at first, (N,)."""
        graph = self._graph
        supervisor = graph.index[graph.supervisor]
        seconds = float(graph.phases[supervisor] + steps / graph.nodes[supervisor].rate)
        # Overruns and waiting stretch the episode; beyond this the room is doubled.
        seconds += 0.04 + seconds / 5000
        return np.array([math.ceil(seconds * self.rates[node.name]) + 8 for node in graph.nodes])

    def rules(self, resolution: int) -> Rules:
        """Return the graph as the kernel reads it."""
        if resolution not in self._rules:
            self._rules[resolution] = self._make_rules(resolution)
        return self._rules[resolution]

    def columns(self, capacity: np.ndarray, resolution: int) -> tuple[Layout, Columns]:
        """Return where steps lie and when they nominally start, for at most capacity[n] steps of node n."""
        place = resolution, capacity.tobytes()
        if place not in self._columns:
            layout = layout_of(self._graph, capacity)
            ticks = [self._starts(n, resolution, size + 1) for n, size in enumerate(capacity.tolist())]
            tick_base = layout.step_base[:-1] + np.arange(len(capacity))
            bases = layout.step_base, layout.message_base, layout.window_base
            while len(self._columns) >= _KEPT:
                del self._columns[next(iter(self._columns))]
            self._columns[place] = layout, Columns(*bases, tick_base, np.concatenate(ticks))
        return self._columns[place]

    def _starts(self, node: int, resolution: int, size: int) -> np.ndarray:
        """Nominal starts phase + k / rate [ticks]; rounded only where they must be."""
        first = self._graph.phases[node] * resolution
        period = Fraction(resolution) / self._graph.nodes[node].rate
        if first.denominator == 1 and period.denominator == 1:
            return int(first) + int(period) * np.arange(size, dtype=np.int64)
        known = self._nominal.get((node, resolution), np.zeros(0, dtype=np.int64))
        if len(known) < size:
            more = [round(first + k * period) for k in range(len(known), size)]
            known = np.concatenate([known, np.array(more, dtype=np.int64)])
            self._nominal[node, resolution] = known
        return known[:size]

    def _make_rules(self, resolution: int) -> Rules:
        graph = self._graph
        nodes, edges = graph.nodes, graph.connections
        into = [[e for e, c in enumerate(edges) if c.receiver == node.name] for node in nodes]
        out_of = [[e for e, c in enumerate(edges) if c.sender == node.name] for node in nodes]
        nominal = [
            round((exact_seconds(graph.node(c.sender).delay) + exact_seconds(c.law)) * resolution)
            if c.jitter == "buffer"
            else -1
            for e, c in enumerate(edges)
        ]
        ahead = [
            node.advance and i != [] and all(edges[e].blocking for e in i)
            for node, i in zip(nodes, into, strict=True)
        ]
        return Rules(
            supervisor=graph.index[graph.supervisor],
            rank=np.argsort(np.array(graph.order)),
            ancestor=self._ancestors(),
            frequency=np.array([node.scheduling == "frequency" for node in nodes]),
            unscheduled=np.array(ahead),
            sender=np.array([graph.index[c.sender] for c in edges], dtype=np.int64),
            receiver=np.array([graph.index[c.receiver] for c in edges], dtype=np.int64),
            window=np.array([c.window for c in edges], dtype=np.int64),
            skip=np.array([c.skip for c in edges], dtype=np.bool_),
            blocking=np.array([c.blocking for c in edges], dtype=np.bool_),
            fifo=np.array([c.fifo for c in edges], dtype=np.bool_),
            nominal=np.array(nominal, dtype=np.int64),
            into=np.array([e for i in into for e in i], dtype=np.int64),
            into_base=np.cumsum([0] + [len(i) for i in into]),
            out_of=np.array([e for o in out_of for e in o], dtype=np.int64),
            out_base=np.cumsum([0] + [len(o) for o in out_of]),
        )

    def _ancestors(self) -> np.ndarray:
        graph = self._graph
        reach = np.zeros((len(graph.nodes), len(graph.nodes)), dtype=np.bool_)
        for receiver in graph.order:
            for c in graph.inputs_of(graph.nodes[receiver].name):
                if not c.skip:
                    reach[receiver] |= reach[graph.index[c.sender]]
                    reach[receiver, graph.index[c.sender]] = True
        return reach


def _denominators(laws: Iterable[Delay]) -> list[int]:
    return [exact_fraction(law.mean).denominator for law in laws if law.constant]

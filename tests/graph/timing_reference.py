"""The timing rules and their execution written down as plainly as possible, slow, as an oracle."""

from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from random import Random

import numpy as np
import torch
from hypothesis import strategies as st

from deepkoco.graph import Connection, Delay, Graph, Node, Supervisor
from deepkoco.graph.delay import Stalls, Stream

MS = Fraction(1, 1000)
NEVER = Fraction(10**9)


@dataclass(frozen=True)
class ListedStalls(Stalls):
    """Stalls given by (wait, length) in turn [ms], the same in every schedule but for a shift of 5 ms."""

    listed: tuple[tuple[int, int], ...] = ()

    def stream(self, rows):
        return ListedStallStream(self, rows)

    def intervals(self, row: int) -> list[tuple[Fraction, Fraction]]:
        found, now = [], 5 * row * MS
        for wait, length in self.listed:
            found.append((now + wait * MS, now + (wait + length) * MS))
            now = found[-1][1]
        return found


class ListedStallStream:
    """First what is listed, then none for ever."""

    def __init__(self, stalls, rows):
        self.all = [[*stalls.intervals(row), *[(np.inf, np.inf)] * 100] for row in range(rows)]

    def draw(self, generator, count):
        now = np.array([[(float(b), float(e)) for b, e in row[:count]] for row in self.all])
        self.all = [row[count:] for row in self.all]
        return now[:, :, 0], now[:, :, 1]


def finish(graph: Graph, row: int, channel: str, start: Fraction, work: Fraction) -> Fraction:
    """Walk through the stalls in turn: what is under way, or would begin during one, goes on after it."""
    now, left = start, work
    mine = [s for s in graph.stalls if s.channels is None or channel in s.channels]
    stalls = sorted(interval for s in mine for interval in s.intervals(row))
    for begin, end in stalls:
        if end <= now:
            continue
        if begin > now and now + left <= begin:
            break
        left -= max(begin - now, Fraction(0))
        now = end
    return now + left


@dataclass(frozen=True)
class Listed(Delay):
    """Delays [ms] taken from a list in turn, the same in every environment but for a shift; -1: lost."""

    values: tuple[int, ...]
    law = "listed"

    @property
    def mean(self) -> float:
        arriving = [value for value in self.values if value >= 0] or [0]
        return sum(arriving) / len(arriving) / 1000

    @property
    def highest(self) -> float:
        return max(self.values) / 1000

    @property
    def loses(self) -> bool:
        return min(self.values) < 0

    def at(self, environment: int, index: int) -> Fraction:
        value = self.values[(index + environment) % len(self.values)]
        return value * MS if value >= 0 else NEVER

    def stream(self, rows, period, start=0.0):
        return ListedStream(self, rows)


class ListedStream(Stream):
    """Goes on in the list where the last draws ended."""

    count = 0

    def draw(self, generator, columns):
        first, self.count = self.count, self.count + columns
        numbers = range(first, self.count)
        drawn = np.array([[float(self.law.at(row, i)) for i in numbers] for row in range(self.rows)])
        return np.where(drawn >= NEVER, np.inf, drawn)


@dataclass
class Episode:
    """One environment: exact times, windows and the order of events."""

    t_start: dict[str, list[Fraction]]
    t_end: dict[str, list[Fraction]]
    t_received: dict[str, list[Fraction]]
    windows: dict[str, list[list[int]]]
    order: list[tuple[str, int]] = field(default_factory=list)


def reference_timing(graph: Graph, steps: int, environment: int) -> Episode:
    """Work through rules 1 to 5 event by event, searching all messages anew each time."""
    names = [node.name for node in graph.nodes]
    run = Episode(
        {n: [] for n in names},
        {n: [] for n in names},
        {c.key: [] for c in graph.connections},
        {c.key: [] for c in graph.connections},
    )
    taken: dict[str, list[int]] = {c.key: [] for c in graph.connections}
    shift = dict.fromkeys(names, Fraction(0))
    before = {n: {c.sender for c in graph.inputs_of(n) if not c.skip} for n in names}
    for _ in names:
        before = {n: s.union(*(before[m] for m in s)) for n, s in before.items()}

    @cache
    def tick(name: str, k: int) -> Fraction:
        return graph.phases[graph.index[name]] + k / graph.node(name).rate

    @cache
    def awaited(c: Connection, k: int) -> list[int]:
        """Rule 2: messages nominally started in (tick k-1, tick k], with skip [tick k-1, tick k)."""
        found, i = [], 0
        while tick(c.sender, i) <= tick(c.receiver, k):
            sent, now = tick(c.sender, i), tick(c.receiver, k)
            last = tick(c.receiver, k - 1) if k > 0 else Fraction(-1)
            if (last <= sent < now) if c.skip else (last < sent <= now):
                found.append(i)
            i += 1
        return found

    def next_start(name: str) -> Fraction | None:
        node, k = graph.node(name), len(run.t_start[name])
        blocking = [c for c in graph.inputs_of(name) if c.blocking]
        terms = [Fraction(0), *run.t_end[name][-1:]]
        if not (node.advance and blocking and len(blocking) == len(graph.inputs_of(name))):
            terms.append(tick(name, k) + shift[name])
        for c in blocking:
            for i in awaited(c, k):
                if i >= len(run.t_received[c.key]):
                    return None
                received = run.t_received[c.key][i]
                terms.append(received if received < NEVER else run.t_end[c.sender][i])
        return max(terms)

    def take(c: Connection, k: int, now: Fraction) -> list[int]:
        if c.blocking:
            return [i for i in awaited(c, k) if run.t_received[c.key][i] < NEVER]
        age = Fraction(round(1000 * 10**6 * graph.node(c.sender).delay.mean), 10**9)
        age += Fraction(round(1000 * 10**6 * c.law.mean), 10**9)
        found = []
        for i, received in enumerate(run.t_received[c.key]):
            there = max(received, tick(c.sender, i) + age) if c.jitter == "buffer" else received
            if received < NEVER and i not in taken[c.key] and (there < now if c.skip else there <= now):
                found.append(i)
        return sorted(found, key=lambda i: (run.t_received[c.key][i], i))

    while True:
        starts = {n: next_start(n) for n in names}
        open_ = {n for n in names if starts[n] is None}
        ranked = [
            (starts[n], bool(before[n] & open_), graph.order.index(graph.index[n]), n)
            for n in names
            if starts[n] is not None
        ]
        now, _, _, name = min(ranked)
        node, k = graph.node(name), len(run.t_start[name])
        for c in graph.inputs_of(name):
            taken[c.key] += take(c, k, now)
            everything = list(range(-c.window, 0)) + taken[c.key]
            run.windows[c.key].append(everything[-c.window :])
        run.t_start[name].append(now)
        run.order.append((name, k))
        if name == graph.supervisor and k == steps:
            return run
        computation = node.delay.at(environment, k) if isinstance(node.delay, Listed) else Fraction(0)
        run.t_end[name].append(finish(graph, environment, name, now, computation))
        for c in graph.connections:
            if c.sender == name:
                communication = c.law.at(environment, k)
                received = run.t_received[c.key]
                if communication >= NEVER:
                    received.append(NEVER)
                    continue
                arrival = finish(graph, environment, c.key, run.t_end[name][-1], communication)
                earlier = [t for t in received if t < NEVER]
                received.append(max([arrival, *earlier[-1:]]) if c.fifo else arrival)
        if node.scheduling == "frequency":
            shift[name] += max(Fraction(0), run.t_end[name][-1] - now - 1 / node.rate)


def reference_execution(graph: Graph, run: Episode, state: dict, policy) -> tuple[list, dict]:
    """Run one environment step by step in the order of events, keeping every output for ever."""
    outputs = {}
    for node in graph.nodes:
        for i in range(1, 9):
            outputs[node.name, -i] = node.initial_output({}, state[node.name], 1)
    seen = []
    for name, k in run.order:
        node = graph.node(name)
        data = {
            c.name: torch.stack([outputs[c.sender, i] for i in run.windows[c.key][k]], dim=1)
            for c in graph.inputs_of(name)
        }
        if name == graph.supervisor:
            seen.append(data)
            outputs[name, k] = policy(data, k)
        else:
            state[name], outputs[name, k] = node.step({}, state[name], {n: Seen(d) for n, d in data.items()})
    return seen, state


@dataclass
class Seen:
    """An input of which only the data is looked at."""

    data: torch.Tensor


class Accumulate(Node):
    """Adds up what it sees, with a memory; only products and sums, so that every order of batching agrees."""

    def init(self, parameters, generator, batch):
        return {"x": torch.rand(batch, 2, dtype=torch.float64, generator=generator), "k": torch.zeros(batch)}

    def initial_output(self, parameters, state, batch):
        return state["x"] * 2

    def step(self, parameters, state, inputs):
        x = state["x"] * 0.9 + 0.01
        for name in sorted(inputs):
            data = inputs[name].data
            for place in range(data.shape[1]):
                x = x + data[:, place] * (0.1 * (place + 1))
        k = state["k"] + 1
        return {"x": x, "k": k}, x - 0.125 * k[:, None]


def policy(data: dict, step: int) -> torch.Tensor:
    """An action that depends on everything the supervisor sees and on its step."""
    action = torch.full((len(next(iter(data.values()))), 2), 0.01 * step, dtype=torch.float64)
    for name in sorted(data):
        for place in range(data[name].shape[1]):
            action = action + data[name][:, place] * 0.3
    return action


def graphs(lossy: bool = False) -> st.SearchStrategy[Graph]:
    """Random graphs of 2 to 5 nodes in which many events fall on the same instant."""
    return st.integers(0, 2**32).map(lambda seed: random_graph(Random(seed), lossy))


def random_graph(random: Random, lossy: bool) -> Graph:
    """Draw a graph; of a lossy one messages get lost and, in half of them, stalls hold it up."""
    size = random.randint(2, 5)

    def listed(values: list[int], most: int) -> Listed:
        return Listed(tuple(random.choices(values, k=random.randint(1, most))))

    def communication() -> Listed:
        return listed([-1, 0, 5, 10, 25, 30] if lossy else [0, 5, 10, 15, 20, 25, 30], 4)

    supervisor = random.randrange(size)
    nodes: list[Node] = []
    for n in range(size):
        options = {
            "rate": random.choice([10, 20, 30, 40, 50, 60, 100, Fraction(25, 3)]),
            "delay": listed([5 * n for n in range(13)], 3) if random.random() < 0.5 else Listed((0,)),
            "scheduling": random.choice(["frequency", "phase"]),
            # Several of these could drive each other at infinite speed; the last one has a clocked sender.
            "advance": n == size - 1 and random.random() < 0.5,
        }
        if n == supervisor:
            action = torch.tensor([0.5, -0.5], dtype=torch.float64)
            nodes.append(Supervisor("agent", initial_action=action, **options))
        else:
            nodes.append(Accumulate(f"n{n}", **options))
    pairs = [(a, b) for a in range(size) for b in range(size) if random.randrange(3) or b == a + 1]
    connections = [
        Connection(
            nodes[a].name,
            nodes[b].name,
            communication(),
            window=random.randint(1, 3),
            skip=a >= b or random.randrange(5) == 0,
            blocking=random.randrange(3) == 0,
            jitter=random.choice(["latest", "latest", "buffer"]),
            fifo=random.randrange(4) > 0,
        )
        for a, b in pairs
    ]
    if not any(c.receiver == "agent" for c in connections):
        connections.append(Connection(nodes[supervisor - 1].name, "agent", communication(), skip=True))
    stalls = []
    if lossy and random.random() < 0.5:
        names = [node.name for node in nodes] + [c.key for c in connections]
        for _ in range(random.randint(1, 2)):
            intervals = [
                (5 * random.randrange(13), random.choice([0, 5, 20, 60, 150]))
                for _ in range(random.randint(1, 6))
            ]
            some = tuple(random.sample(names, random.randint(1, len(names))))
            channels = some if random.random() < 0.5 else None
            stalls.append(ListedStalls(1.0, 0.0, channels=channels, listed=tuple(intervals)))
    return Graph(nodes, connections, stalls=stalls)

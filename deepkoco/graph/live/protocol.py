"""The synchronisation protocol: which messages a tick needs follows from counting alone.

Every node starts at 0 and ticks at k/f. Message i of a sender of rate f_i, tau after its tick, is usable at
tick k of a node of rate f_n if and only if

    i/f_i + tau <= k/f_n, or i = k = 0;    on a cyclic (skipped) connection besides i/f_i < k/f_n.

So each node knows how many messages it must have received before it may step, without clock or coordinator.

Source: van der Heijden et al., EAGERx: Graph-Based Framework for Sim2real Robot Learning, 2024, Alg. 1-3.
"""

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np

from deepkoco.graph.delay import exact_seconds
from deepkoco.graph.live.plan import NodePlan, Plan, PlannedStep, Window
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError

CyclicCount = Callable[[int, Fraction, Fraction, Fraction], int]
"""Messages usable at a tick, from the tick, the rates of sender and receiver and the delay."""


class ProtocolError(GraphError):
    """The graph asks for what counting alone cannot tell; the message names the node or connection."""


def expected_count(
    tick: int, sender_rate: Fraction, rate: Fraction, delay: Fraction, cyclic: bool = False
) -> int:
    """Count the messages that are usable at a tick, those of earlier ticks included, exactly.

    Args:
        tick: k of the receiver; before tick 0 nothing is usable.
        sender_rate, rate: ticks per second of sender and receiver [Hz].
        delay: tau, from the sender's tick to the arrival [s].
        cyclic: whether the connection skips, so that a message of the same instant is for the next tick.

    Returns:
        Messages 0 ... count - 1 are usable.

    Source: the rule that Alg. 2 states; for cyclic connections that of the text, not that of the program.
    """
    if tick < 0:
        return 0
    now = tick / rate
    arrived = max(0, math.floor((now - delay) * sender_rate) + 1)
    if cyclic:
        return min(arrived, math.ceil(now * sender_rate))
    return max(1, arrived)


def cyclic_count(tick: int, sender_rate: Fraction, rate: Fraction, delay: Fraction) -> int:
    """Count the messages that are usable at a tick of a cyclic connection; see `expected_count`."""
    return expected_count(tick, sender_rate, rate, delay, cyclic=True)


def published_cyclic_count(tick: int, sender_rate: Fraction, rate: Fraction, delay: Fraction) -> int:
    """Count the messages on a cyclic connection as the authors' program does, in exact arithmetic.

    For comparison only: with N(x) = floor((x/f_n - tau) f_i) it awaits min(N(k + o) - N(k + o - 1), N(k) + 1)
    further messages, at least 0, at tick k > 0, where the shift o is the whole ticks between two messages of
    a slower sender and -1 with any other. That is one message fewer than the rule gives, at some ticks, or one
    more, which has been sent but is still under way.

    Source: EAGERx 0.1.40, `expected_inputs` with `skip=True`.
    """
    shift = math.ceil(rate / sender_rate) - 1 if rate > sender_rate else -1
    period, under_way = sender_rate / rate, delay * sender_rate
    unit = math.lcm(period.denominator, under_way.denominator)
    step, lag = int(period * unit), int(under_way * unit)  # whole numbers: many ticks are added up

    def sent(k: int) -> int:
        return (k * step - lag) // unit

    return sum(max(0, min(sent(k + shift) - sent(k + shift - 1), sent(k) + 1)) for k in range(1, tick + 1))


class ProtocolPlan(Plan):
    """What each step waits for by the protocol, for constant delays and without end.

    The delay of a connection is the sender's computation delay plus the connection's own. Phases of the graph
    are not looked at: all nodes start at 0, which is what makes message 0 available at tick 0.

    Args:
        graph: nodes with constant delays no longer than their period; connections that do not block. A jitter
            buffer changes nothing, for every message comes at its nominal instant.
        count: of the messages usable on a cyclic connection; `published_cyclic_count` for comparison.

    Raises:
        ProtocolError: the graph has something else; draw a timing for it.
    """

    steps = None

    def __init__(self, graph: Graph, count: CyclicCount = cyclic_count) -> None:
        for node in graph.nodes:
            if not node.delay.constant:
                raise ProtocolError(f'node "{node.name}": random computation delay; draw a timing instead')
            if exact_seconds(node.delay) > 1 / node.rate:
                raise ProtocolError(
                    f'node "{node.name}": computes {node.delay.mean:g} s, longer than its period '
                    f"{float(1 / node.rate):g} s; draw a timing instead"
                )
        for connection in graph.connections:
            if not connection.law.constant or connection.law.loses:
                raise ProtocolError(f'connection "{connection.key}": random delay; draw a timing instead')
            if connection.blocking:
                raise ProtocolError(f'connection "{connection.key}": blocks; draw a timing instead')
        self._graph, self._count = graph, count

    def of(self, node: str) -> "ProtocolNodePlan":
        graph = self._graph
        own, supervisor = graph.node(node), graph.node(graph.supervisor)
        inputs = graph.inputs_of(node)
        return ProtocolNodePlan(
            rate=own.rate,
            computation=exact_seconds(own.delay),
            senders=tuple(graph.node(c.sender).rate for c in inputs),
            sent_after=tuple(exact_seconds(graph.node(c.sender).delay) for c in inputs),
            delays=tuple(self._delay(c) for c in inputs),
            counts=tuple(self._count if c.skip else expected_count for c in inputs),
            windows=tuple(c.window for c in inputs),
            supervisor_rate=supervisor.rate,
            before=graph.order.index(graph.index[node]) < graph.order.index(graph.index[graph.supervisor]),
        )

    def arrivals(self, connection: Connection, first: int, last: int) -> np.ndarray:
        rate, delay = self._graph.node(connection.sender).rate, self._delay(connection)
        return np.array([float(i / rate + delay) for i in range(first, last)])

    def _delay(self, connection: Connection) -> Fraction:
        return exact_seconds(self._graph.node(connection.sender).delay) + exact_seconds(connection.law)


class ProtocolNodePlan(NodePlan):
    """One node's part of the protocol: rates and delays of its inputs, in their order [Hz, s]."""

    def __init__(
        self,
        rate: Fraction,
        computation: Fraction,
        senders: tuple[Fraction, ...],
        sent_after: tuple[Fraction, ...],
        delays: tuple[Fraction, ...],
        counts: tuple[CyclicCount, ...],
        windows: tuple[int, ...],
        supervisor_rate: Fraction,
        before: bool,
    ) -> None:
        self.rate, self.computation = rate, computation
        self.senders, self.sent_after, self.delays = senders, sent_after, delays
        self.counts, self.windows = counts, windows
        self.supervisor_rate, self.before = supervisor_rate, before

    def step(self, tick: int) -> PlannedStep:
        windows, oldest = [], []
        for e, size in enumerate(self.windows):
            rate, delay, sent = self.senders[e], self.delays[e], self.sent_after[e]
            count = self.counts[e](tick, rate, self.rate, delay)
            # Alg. 1, line 13: the oldest messages not taken yet come first, then the window moves on.
            seq = tuple(range(count - size, count))
            windows.append(
                Window(
                    seq=seq,
                    t_sent=tuple(float(i / rate + sent) if i >= 0 else -math.inf for i in seq),
                    t_received=tuple(float(i / rate + delay) if i >= 0 else -math.inf for i in seq),
                )
            )
            oldest.append(count - size)
        start = tick / self.rate
        return PlannedStep(float(start), float(start + self.computation), tuple(windows), tuple(oldest))

    def limit(self, supervisor_step: int) -> int:
        now = supervisor_step * self.rate / self.supervisor_rate
        # At one instant the topological order decides who comes first.
        return math.floor(now) + 1 if self.before else math.ceil(now)

"""The driver of real time: rules 2 to 6 of the exact timing with the arrivals as they are."""

import math
import time
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from torch import Tensor

from deepkoco.graph.delay import Delay, exact_seconds
from deepkoco.graph.delay.law import Stream
from deepkoco.graph.live.driver import Driver
from deepkoco.graph.live.message import Message
from deepkoco.graph.live.plan import Window
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input

NANO = 10**9


@dataclass(frozen=True)
class ClockedInput:
    """What a node must know about one of its inputs.

    Attributes:
        window, skip, blocking, fifo: as in the connection.
        phase, rate: of the sender [s, Hz].
        age: expected age of a message on arrival if it is to be buffered until then [s], else None.
        silence: greatest age of the newest message [ns], after which the node must not run on; None: any.
    """

    window: int
    skip: bool
    blocking: bool
    fifo: bool
    phase: Fraction
    rate: Fraction
    age: Fraction | None
    silence: int | None = None

    @classmethod
    def of(cls, graph: Graph, connection: Connection) -> "ClockedInput":
        """Collect it from a graph."""
        sender = graph.node(connection.sender)
        age = exact_seconds(sender.delay) + exact_seconds(connection.law)
        return cls(
            connection.window,
            connection.skip,
            connection.blocking,
            connection.fifo,
            graph.phases[graph.index[sender.name]],
            sender.rate,
            age if connection.jitter == "buffer" else None,
        )

    def nominal(self, seq: int) -> Fraction:
        """Nominal start of the step that makes a message [s]."""
        return self.phase + seq / self.rate


@dataclass(frozen=True)
class ClockedSchedule:
    """What a node must know to run by the clock.

    Attributes:
        rate, phase: [Hz], [s].
        frequency: frequency scheduling: an own overrun shifts all later ticks; else they catch up.
        unscheduled: starts as soon as its blocking inputs are there.
        inputs: in the order of the graph.
        computation: simulated computation delay; None: what the computation really takes.
        communication: by number of the connection, simulated delays of what it sends; none where they are real.
        seed: of the simulated delays.
    """

    rate: Fraction
    phase: Fraction
    frequency: bool
    unscheduled: bool
    inputs: tuple[ClockedInput, ...]
    computation: Delay | None = None
    communication: dict[int, Delay] = field(default_factory=dict)
    seed: int = 0

    def nominal(self, tick: int) -> Fraction:
        """Nominal start of a tick [s]."""
        return self.phase + tick / self.rate


def clocked_schedule(graph: Graph, name: str, simulate_delays: bool, seed: int) -> ClockedSchedule:
    """Collect a node's schedule from a graph."""
    node, inputs, position = graph.node(name), graph.inputs_of(name), graph.index[name]
    sends = {e: c.law for e, c in enumerate(graph.connections) if c.sender == name}
    return ClockedSchedule(
        rate=node.rate,
        phase=graph.phases[position],
        frequency=node.scheduling == "frequency",
        unscheduled=node.advance and bool(inputs) and all(c.blocking for c in inputs),
        inputs=tuple(ClockedInput.of(graph, c) for c in inputs),
        computation=node.delay if simulate_delays and name != graph.supervisor else None,
        communication=sends if simulate_delays else {},
        seed=seed * len(graph.nodes) + position,
    )


class SilentInputError(RuntimeError):
    """Messages of an input that must not stop have stopped."""


class _Queue:
    """Messages of one input that have come and were not taken yet, and the window of those that were."""

    def __init__(self, rule: ClockedInput) -> None:
        self.rule = rule
        self.waiting: dict[int, tuple[int, int]] = {}  # seq -> t_sent, t_received [ns]
        self.window = [(seq, -1, -1) for seq in range(-rule.window, 0)]
        self.awaited = 0  # next message of a blocking input
        self.last = 0  # arrival of the last message [ns]
        self.newest: int | None = None  # up to when the sender is known to live [ns]

    def arrive(self, message: Message, now: int) -> int:
        """Keep a message.

        Args:
            message: what has come.
            now: when it has come [ns], by the clock alone.

        Returns:
            When it counts as received [ns].
        """
        received = max(now, message.t_sent, message.due, self.last if self.rule.fifo else 0)
        self.last = received
        # On a path slower than the traffic old messages come without a pause, and no stamp of the sender's counts
        # for more than the instant at which it is read.
        known = min(now, message.t_sent)
        self.newest = known if self.newest is None else max(self.newest, known)
        self.waiting[message.seq] = message.t_sent, received
        return received

    @property
    def expires(self) -> int | None:
        """When the silence is too long [ns]; None where it never is. Before the first message nothing is awaited."""
        if self.newest is None or self.rule.silence is None:
            return None
        return self.newest + self.rule.silence

    def there(self, seq: int, now: int) -> bool:
        received = self.waiting[seq][1]
        if self.rule.age is not None and Fraction(now, NANO) < self.rule.nominal(seq) + self.rule.age:
            return False
        return received < now or (received == now and not self.rule.skip)

    def blocks(self, tick: Fraction) -> int | None:
        """Return the last message that rule 2 waits for at a nominal tick; None where it waits for none."""
        first = self.rule.nominal(self.awaited)
        if first > tick or (self.rule.skip and first == tick):
            return None
        steps = (tick - self.rule.phase) * self.rule.rate
        return math.ceil(steps) - 1 if self.rule.skip else math.floor(steps)

    def take(self, now: int, until: int | None) -> list[int]:
        """Move messages into the window, in the order of arrival; return those that fall out of it."""
        if self.rule.blocking:
            taken = [] if until is None else list(range(self.awaited, until + 1))
            self.awaited += len(taken)
        else:
            there = [seq for seq in self.waiting if self.there(seq, now)]
            taken = sorted(there, key=lambda seq: (self.waiting[seq][1], seq))
        self.window += [(seq, *self.waiting.pop(seq)) for seq in taken]
        gone = self.window[: -self.rule.window]
        self.window = self.window[-self.rule.window :]
        return [seq for seq, _, _ in gone if seq >= 0]

    def seen(self) -> Window:
        seq, sent, received = zip(*self.window, strict=True)
        return Window(
            seq,
            tuple(-math.inf if i < 0 else t / NANO for i, t in zip(seq, sent, strict=True)),
            tuple(-math.inf if i < 0 else t / NANO for i, t in zip(seq, received, strict=True)),
        )


class ClockedDriver(Driver):
    """Runs a node on an absolute schedule and records when it really ran.

    Every tick is run exactly once, late ones too. Time is counted in whole nanoseconds of the episode, so that
    the record decides exactly as the run did which message was there.

    Args:
        schedule: rate, phase and inputs.
    """

    def __init__(self, *args: Any, schedule: ClockedSchedule) -> None:
        super().__init__(*args)
        self.schedule = schedule
        self._queues = [_Queue(rule) for rule in schedule.inputs]
        self._shift = 0  # [ns]
        self._start = self._end = 0  # [ns]
        self._random = np.random.default_rng(schedule.seed)
        period = float(1 / schedule.rate)
        law, first = schedule.computation, schedule.phase
        self._computation = law and law.stream(1, period, float(first))
        sent = float(first if law is None else first + exact_seconds(law))
        self._communication = {e: law.stream(1, period, sent) for e, law in schedule.communication.items()}
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._windows: list[list[tuple[int, ...]]] = [[] for _ in schedule.inputs]
        self._received: list[list[tuple[int, int, int]]] = [[] for _ in schedule.inputs]
        self._reported_messages = [0 for _ in schedule.inputs]

    def begin(self, until: int | None = None) -> dict[str, Input] | None:
        tick = self.schedule.nominal(self.tick)
        # A tick between two nanoseconds starts at the later one.
        scheduled = 0 if self.schedule.unscheduled else math.ceil(tick * NANO) + self._shift
        earliest = max(scheduled, self._end)
        awaited = [queue.blocks(tick) if queue.rule.blocking else None for queue in self._queues]
        while True:
            now = self._absorb()
            if until is not None or self.inbox.ordered():
                return None
            expires = self._check_silence(now)
            arrival = self._arrival(awaited)
            if arrival is None:
                self.inbox.wait(None if expires is None else self._instant(expires))
            elif now < (start := max(earliest, arrival)):
                wake = start if expires is None else min(start, expires)
                self.inbox.wait(self._instant(wake), messages=False)
            else:
                break
        windows = []
        for place, (queue, last) in enumerate(zip(self._queues, awaited, strict=True)):
            for seq in queue.take(now, last):
                self.runner.drop(place, seq)
            windows.append(queue.seen())
            self._windows[place].append(windows[-1].seq)
        self._start, self.time = now, now / NANO
        self._starts.append(now)
        return self.runner.look(self.time, windows)

    def finish(self, output: Tensor) -> None:
        end = max(self._now(), self._start)
        if self._computation is not None:
            end = max(end, self._start + round(self._draw(self._computation) * NANO))
        self._keep(output)
        self._ends.append(end)
        if self.schedule.frequency:
            # An own overrun shifts later ticks, waiting does not.
            self._shift += max(0, end - self._start - math.ceil(NANO / self.schedule.rate))
        for outlet in self.outlets:
            stream = self._communication.get(outlet.edge)
            delay = 0.0 if stream is None else self._draw(stream)
            if delay < math.inf:  # else the message is lost
                due = end + round(delay * NANO)
                outlet.send(Message(self.inbox.episode, outlet.edge, self.tick, end, due, output))
        self._end = end
        self.tick += 1

    def log(self) -> dict[str, Any]:
        self._absorb()
        # A node that was given up may still end its step meanwhile: what comes after these is not wanted.
        ended = len(self._ends)
        received = [len(arrivals) for arrivals in self._received]
        return self._entries(0, ended, len(self._starts), [0] * len(received), received)

    def news(self) -> dict[str, Any] | None:
        ended, received = len(self._ends), [len(arrivals) for arrivals in self._received]
        first, since = self._reported, self._reported_messages
        if (first, since) == (ended, received):
            return None
        self._reported, self._reported_messages = ended, received
        return {"first": first} | self._entries(first, ended, ended, since, received)

    def _entries(
        self, first: int, ended: int, begun: int, since: list[int], received: list[int]
    ) -> dict[str, Any]:
        """Steps from `first` on, as arrays, and by input the messages from `since` on."""
        return {
            "outputs": self._stacked(first, ended),
            "t_start": np.array(self._starts[first:begun], dtype=np.int64),
            "t_end": np.array(self._ends[first:ended], dtype=np.int64),
            "windows": [
                np.array(windows[first:begun], dtype=np.int32).reshape(-1, rule.window)
                for windows, rule in zip(self._windows, self.schedule.inputs, strict=True)
            ],
            "received": [
                np.array(arrivals[start:stop], dtype=np.int64).reshape(-1, 3)
                for arrivals, start, stop in zip(self._received, since, received, strict=True)
            ],
        }

    def _now(self) -> int:
        return self._time(time.monotonic_ns())

    def _time(self, instant: int) -> int:
        """Turn an instant [ns, monotonic] into a time of the episode [ns]."""
        passed = instant + self._ahead() - self.origin
        return passed if self.factor == 1.0 else math.floor(passed * self.factor)

    def _absorb(self) -> int:
        instant, messages = self.inbox.take()
        for message, stamp in messages:
            place = self.places[message.edge]
            received = self._queues[place].arrive(message, self._time(stamp))
            self._received[place].append((message.seq, message.t_sent, received))
            self.runner.put(place, message.seq, message.data)
        return self._time(instant)

    def _check_silence(self, now: int) -> int | None:
        """Return when the first of the inputs that must not stop will have been silent for too long [ns].

        Raises:
            SilentInputError: one has been.
        """
        ends = [
            (queue.expires, place) for place, queue in enumerate(self._queues) if queue.expires is not None
        ]
        if not ends:
            return None
        expires, place = min(ends)
        if now > expires:
            queue = self._queues[place]
            assert queue.rule.silence is not None
            assert queue.newest is not None
            limit = f"{queue.rule.silence / 1e6:.0f} ms is the limit"
            age, pause = (now - queue.newest) / 1e6, (now - queue.last) / 1e6
            what = f"no message for {age:.0f} ms"
            if pause <= 1e3 / queue.rule.rate:  # they come at the rate of their sender, and are old
                what = f"the newest message is {age:.0f} ms old, though one came {max(0.0, pause):.0f} ms ago"
            raise SilentInputError(f"{self.runner.inputs[place].key}: {what}, and {limit}")
        return expires

    def _arrival(self, awaited: list[int | None]) -> int | None:
        """Return when all awaited messages are there [ns], as far as it is known; None where one has not come."""
        latest = 0
        for queue, last in zip(self._queues, awaited, strict=True):
            for seq in range(queue.awaited, -1 if last is None else last + 1):
                if seq not in queue.waiting:
                    return None
                latest = max(latest, queue.waiting[seq][1])
        return latest

    def _draw(self, stream: Stream) -> float:
        return float(stream.draw(self._random, 1)[0, 0])

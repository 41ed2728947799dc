"""Replay: measured times in the place of drawn delays, under the same rules; some nodes may be added."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from deepkoco.graph.delay import Deterministic
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.computation_graph import ComputationGraph, Layout
from deepkoco.graph.timing.draw import MOST_STRETCH, draw_seed, empty_times, laws_of, resolution_of
from deepkoco.graph.timing.drawn import DrawnDelays
from deepkoco.graph.timing.kernel import DONE, FULL, LOST, UNSTALLED, run_rows
from deepkoco.graph.timing.origin import Origin
from deepkoco.graph.timing.overrides import Delays, TimingError
from deepkoco.graph.timing.plan import plan_of
from deepkoco.graph.timing.rule_tables import Draws, Measured, Times


@dataclass(frozen=True)
class MeasuredTiming:
    """When one episode really ran [s].

    Attributes:
        t_start, t_end: by node name, start and end of each of its steps.
        t_received: by connection key, arrival of each message; message i is sent at the end of the
            sender's step i. A message that never arrived has infinity.
    """

    t_start: Mapping[str, np.ndarray]
    t_end: Mapping[str, np.ndarray]
    t_received: Mapping[str, np.ndarray]


def replay_timing(
    graph: Graph,
    measured: MeasuredTiming,
    batch: int = 1,
    windows: Mapping[str, np.ndarray] | None = None,
    *,
    added: Iterable[str] = (),
    generator: np.random.Generator | torch.Generator | None = None,
    delays: Delays | None = None,
    rows: int | None = None,
) -> ComputationGraph:
    """Put measured times in the place of drawn delays, under the same rules.

    The starts are the measured ones; what each step sees follows from the arrivals, or is what it saw.

    Nodes that are `added` have no measured times: they run at their own rate, and their delays are drawn as by
    `draw_timing`. So do the messages of connections that were not measured. With the generator of the timing
    that was recorded, added nodes and connections have the delays that they had there.

    Args:
        graph: the graph that ran, with the nodes that are added to it.
        measured: times of one episode, in which the supervisor started at least two steps.
        batch: environments that all replay the episode.
        windows: by connection key, (K, window) messages that each of the receiver's K steps saw, as in `Episode`.
            Of a connection that is not named they follow from the arrivals. A run by the protocol sees message 0
            before it arrives, so only its recorded windows replay it.
        added: nodes that were not measured, by name, and connections between measured nodes that were not, by key.
            A connection from an added node is added with it, and so is one to an added node without measured times.
        generator: where the delays of what was not measured come from; needed only where they are random.
        delays: in the place of the graph's own laws, as for `draw_timing`: of added nodes, of connections that
            were not measured.
        rows: number of different schedules, as for `draw_timing`; None: one where no delay is random or given
            for each schedule, else one for each environment.

    Raises:
        TimingError: times are missing, not finite, or run backwards; windows have another shape, or hold a message
            that was not sent by then or never arrived; what is added is no node or connection, the supervisor, or was
            measured; a delay is given for something that was measured.
    """
    new = _added_channels(graph, measured, tuple(added))
    for key in delays or {}:
        if key in plan_of(graph).places and key not in new:
            raise TimingError(f'delay of "{key}": it was measured; delays are given for what is added')
    laws = laws_of(graph, delays or {}, rows or batch)
    drawn = {key for key in new if key in laws.own or not laws.same.get(key, Deterministic(0.0)).constant}
    if generator is None and (drawn or (new and graph.stalls)):
        raise TimingError(
            f"{', '.join(sorted(drawn)) or 'stalls'}: delays are random; give a generator to draw them from"
        )
    if rows is None:
        differs = drawn or graph.stalls or any(key in laws.constants for key in new)
        rows = batch if new and differs else 1
    seed = 0 if generator is None else draw_seed(generator)
    origin = Origin(graph, seed, laws, graph.correlations, graph.stalls if new else (), rows, None)
    record = _Record(graph, measured, new, resolution_of(origin))
    layout, times = _work_out(origin, record)
    _put_windows(graph, layout, times, {key: seen for key, seen in (windows or {}).items() if key not in new})
    row = np.arange(batch, dtype=np.int64) % rows
    return ComputationGraph(layout, record.resolution, record.steps, row, *times)


def _added_channels(graph: Graph, measured: MeasuredTiming, added: tuple[str, ...]) -> frozenset[str]:
    """Nodes and connections that were not measured.

    Raises:
        TimingError: what is added is no node or connection, the supervisor, or was measured.
    """
    keys = [connection.key for connection in graph.connections]
    for name in added:
        if name not in graph.index and name not in keys:
            raise TimingError(
                f'added "{name}" is no node or connection; known: {", ".join((*graph.index, *keys))}'
            )
        if name == graph.supervisor:
            raise TimingError(f'supervisor "{name}" cannot be added: its measured steps give the actions')
        if name in measured.t_start or name in measured.t_received:
            raise TimingError(
                f'added "{name}" was measured; take its times out of the record, or do not add it'
            )
    new = {
        c.key
        for c in graph.connections
        if c.sender in added or (c.receiver in added and c.key not in measured.t_received)
    }
    return frozenset((*added, *new))


class _Record:
    """The measured times of a graph in ticks, checked.

    Attributes:
        steps: that the supervisor took.
        new: nodes and connections that were not measured.
    """

    def __init__(self, graph: Graph, measured: MeasuredTiming, new: frozenset[str], resolution: int) -> None:
        self.graph, self.new, self.resolution = graph, new, resolution
        self.start: dict[str, np.ndarray] = {}
        self.end: dict[str, np.ndarray] = {}
        self.received: dict[str, np.ndarray] = {}
        for node in graph.nodes:
            if node.name not in new:
                self._read_steps(measured, node.name)
        for connection in graph.connections:
            if connection.key not in new:
                self._read_messages(measured, connection.key, connection.sender)
        self.steps = len(self.start[graph.supervisor]) - 1
        if self.steps < 1:
            raise TimingError(
                f'supervisor "{graph.supervisor}" has {self.steps + 1} measured starts; at least 2 wanted'
            )

    def _read_steps(self, measured: MeasuredTiming, name: str) -> None:
        start = self.start[name] = _ticks(measured.t_start, name, self.resolution)
        end = self.end[name] = _ticks(measured.t_end, name, self.resolution, len(start))
        never = np.flatnonzero((start >= LOST) | (end >= LOST))
        if len(never):
            raise TimingError(f'node "{name}": step {never[0]} never starts or never ends')
        previous = np.concatenate([[-LOST], end[:-1]])
        bad = np.flatnonzero((start < previous) | (end < start))
        if len(bad):
            raise TimingError(f'node "{name}": step {bad[0]} starts before its last one ends, or ends first')

    def _read_messages(self, measured: MeasuredTiming, key: str, sender: str) -> None:
        sent = self.end[sender]
        received = _ticks(measured.t_received, key, self.resolution, len(sent), missing_at_end=True)
        bad = np.flatnonzero(received < sent[: len(received)])
        if len(bad):
            raise TimingError(f'connection "{key}": message {bad[0]} arrives before it is sent')
        self.received[key] = received

    def capacity(self) -> np.ndarray:
        """For how many steps of every node there is room at first, (N,)."""
        # One column more than was measured: a node whose record ends does nothing more.
        seconds = 1.01 * float(self.start[self.graph.supervisor][-1]) / self.resolution
        return np.array(
            [
                math.ceil(seconds * float(node.rate)) + 8
                if node.name in self.new
                else len(self.start[node.name]) + 1
                for node in self.graph.nodes
            ]
        )

    def starts(self, layout: Layout) -> Measured:
        """The measured starts as the kernel reads them."""
        start = np.full(layout.step_base[-1], LOST, dtype=np.int64)
        for n, name in enumerate(layout.names):
            if name not in self.new:
                start[layout.step_base[n] :][: len(self.start[name])] = self.start[name]
        node = np.array([name not in self.new for name in layout.names])
        return Measured(
            start, node, np.array([key not in self.new for key in layout.connections], dtype=np.bool_)
        )

    def put_in(self, draws: Draws, layout: Layout) -> Draws:
        """Delays in which those that were measured take the place of drawn ones; no stall holds them up."""
        first, stride, stalled = draws.first.copy(), draws.stride.copy(), draws.stalled.copy()
        blocks, width = [draws.values], draws.values.shape[1]
        for c, key in enumerate((*layout.names, *layout.connections)):
            if key in self.new:
                continue
            node = c < len(layout.names)
            size = np.diff(layout.step_base if node else layout.message_base)[
                c if node else c - len(layout.names)
            ]
            own = np.full(size, 0 if node else LOST, dtype=np.int64)
            if node:
                own[: len(self.end[key])] = self.end[key] - self.start[key]
            else:
                received = self.received[key]
                sent = self.end[self.graph.connections[c - len(layout.names)].sender][: len(received)]
                own[: len(received)] = np.where(received >= LOST, LOST, received - sent)
            first[c], stride[c], stalled[:, c] = width, 1, False
            blocks.append(np.broadcast_to(own, (len(draws.values), size)))
            width += size
        return draws._replace(
            values=np.concatenate(blocks, axis=1), first=first, stride=stride, stalled=stalled
        )


def _work_out(origin: Origin, record: _Record) -> tuple[Layout, Times]:
    plan = plan_of(origin.graph)
    rules = plan.rules(record.resolution)
    capacity = planned = record.capacity()
    drawn = DrawnDelays(origin.graph, origin, record.resolution) if record.new else None
    new = np.array([node.name in record.new for node in origin.graph.nodes])
    while True:
        layout, columns = plan.columns(capacity, record.resolution)
        draws = _no_delays(len(plan.channels)) if drawn is None else drawn.up_to(capacity)
        times = empty_times(layout, origin.rows, record.steps)
        status = run_rows(
            record.steps, rules, columns, record.put_in(draws, layout), record.starts(layout), times
        )
        if status == DONE:
            return layout, times
        if status == UNSTALLED and drawn is not None:
            drawn.draw_stalls()
            continue
        if status != FULL or not new.any():
            raise TimingError("the measured times end before the last step of the supervisor")
        capacity = np.where(new, 2 * capacity, capacity)
        if (capacity > MOST_STRETCH * planned).any():
            raise TimingError(
                "added nodes with advance=True and only blocking inputs drive each other without any tick"
            )


def _no_delays(channels: int) -> Draws:
    nothing = np.zeros((1, 0, 0), dtype=np.int64)
    places = np.zeros(channels, dtype=np.int64)
    stalled = np.zeros((0, channels), dtype=np.bool_)
    return Draws(np.zeros((1, 0), dtype=np.int64), places, places, nothing, nothing, stalled)


def _put_windows(graph: Graph, layout: Layout, times: Times, windows: Mapping[str, np.ndarray]) -> None:
    """Put recorded windows in the place of those that follow from the arrivals."""
    for e, connection in enumerate(graph.connections):
        if connection.key not in windows:
            continue
        sender, receiver = graph.index[connection.sender], graph.index[connection.receiver]
        counts = times.boundary[0, -1] + (np.arange(len(graph.nodes)) == layout.supervisor)
        seen, steps, size = np.asarray(windows[connection.key]), int(counts[receiver]), connection.window
        where = f'connection "{connection.key}": '
        if seen.ndim != 2 or seen.shape[1] != size or len(seen) < steps:
            raise TimingError(
                f"{where}windows of shape {seen.shape}; expected ({steps}, {size}) for the steps of "
                f'"{connection.receiver}"'
            )
        seen = seen[:steps]
        start = times.t_start[0, layout.step_base[receiver] :][:steps, None]
        # The sender's own step must come first; at one instant the order of the nodes has decided.
        sent = int(times.boundary[0, -1, sender])
        message = np.clip(seen, 0, max(sent - 1, 0))
        begun = times.t_start[0, layout.step_base[sender] + message]
        early = (seen >= 0) & ((seen >= sent) | (begun > start))
        lost = (seen >= 0) & (times.t_received[0, layout.message_base[e] + message] >= LOST)
        for wrong, what in ((early, "was sent later"), (lost, "never arrived")):
            if wrong.any():
                step, place = np.argwhere(wrong)[0]
                raise TimingError(
                    f'{where}step {step} of "{connection.receiver}" saw message {seen[step, place]}, which {what}'
                )
        first = layout.window_base[e]
        times.windows[:, first : first + seen.size] = seen.ravel()


def _ticks(
    times: Mapping[str, np.ndarray],
    name: str,
    resolution: int,
    size: int | None = None,
    missing_at_end: bool = False,
) -> np.ndarray:
    if name not in times:
        raise TimingError(f'"{name}" has no measured times; there are {", ".join(times)}')
    seconds = np.asarray(times[name], dtype=np.float64)
    if seconds.ndim != 1:
        raise TimingError(f'"{name}": measured times have shape {seconds.shape}; expected one number a step')
    if size is not None and (len(seconds) > size or (len(seconds) < size and not missing_at_end)):
        raise TimingError(f'"{name}" has {len(seconds)} measured times for {size} steps')
    if np.isnan(seconds).any():
        raise TimingError(f'"{name}": measured time {np.flatnonzero(np.isnan(seconds))[0]} is not a number')
    lost = ~np.isfinite(seconds)
    return np.where(lost, LOST, np.rint(np.where(lost, 0.0, seconds) * resolution)).astype(np.int64)

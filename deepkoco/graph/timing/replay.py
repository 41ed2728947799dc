"""Replay: measured times in the place of drawn delays, under the same rules."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.computation_graph import ComputationGraph, Layout
from deepkoco.graph.timing.draw import empty_times
from deepkoco.graph.timing.kernel import DONE, LOST, Draws, Times, run_rows
from deepkoco.graph.timing.overrides import TimingError
from deepkoco.graph.timing.plan import plan_of


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
) -> ComputationGraph:
    """Put measured times in the place of drawn delays, under the same rules.

    The starts are the measured ones; what each step sees follows from the arrivals, or is what it saw.

    Args:
        graph: the graph that ran.
        measured: times of one episode, in which the supervisor started at least two steps.
        batch: environments that all replay the episode.
        windows: by connection key, (K, window) messages that each of the receiver's K steps saw, as in `Episode`.
            Of a connection that is not named they follow from the arrivals. A run by the protocol sees message 0
            before it arrives, so only its recorded windows replay it.

    Raises:
        TimingError: times are missing, not finite, or run backwards; windows have another shape, or hold a message
            that was not sent by then or never arrived.
    """
    plan = plan_of(graph)
    resolution = plan.resolution(())
    start, end = {}, {}
    for node in graph.nodes:
        start[node.name] = _ticks(measured.t_start, node.name, resolution)
        end[node.name] = _ticks(measured.t_end, node.name, resolution, len(start[node.name]))
        never = np.flatnonzero((start[node.name] >= LOST) | (end[node.name][: len(start[node.name])] >= LOST))
        if len(never):
            raise TimingError(f'node "{node.name}": step {never[0]} never starts or never ends')
        previous = np.concatenate([[-LOST], end[node.name][:-1]])
        bad = np.flatnonzero((start[node.name] < previous) | (end[node.name] < start[node.name]))
        if len(bad):
            raise TimingError(
                f'node "{node.name}": step {bad[0]} starts before its last one ends, or ends first'
            )
    steps = len(start[graph.supervisor]) - 1
    if steps < 1:
        raise TimingError(
            f'supervisor "{graph.supervisor}" has {steps + 1} measured starts; at least 2 wanted'
        )
    # One column more than was measured: a node whose record ends does nothing more.
    capacity = np.array([len(start[node.name]) + 1 for node in graph.nodes])
    layout, columns = plan.columns(capacity, resolution)
    computation = np.zeros((1, layout.step_base[-1]), dtype=np.int64)
    recorded = np.full((1, layout.step_base[-1]), LOST, dtype=np.int64)
    communication = np.full((1, layout.message_base[-1]), LOST, dtype=np.int64)
    for n, node in enumerate(graph.nodes):
        place = slice(layout.step_base[n], layout.step_base[n] + len(start[node.name]))
        recorded[0, place] = start[node.name]
        computation[0, place] = end[node.name] - start[node.name]
    for e, connection in enumerate(graph.connections):
        sent = end[connection.sender]
        received = _ticks(measured.t_received, connection.key, resolution, len(sent), missing_at_end=True)
        bad = np.flatnonzero(received < sent[: len(received)])
        if len(bad):
            raise TimingError(f'connection "{connection.key}": message {bad[0]} arrives before it is sent')
        place = slice(layout.message_base[e], layout.message_base[e] + len(received))
        lost = received >= LOST
        communication[0, place] = np.where(lost, LOST, received - sent[: len(received)])
    first = np.concatenate([layout.step_base[:-1], layout.step_base[-1] + layout.message_base[:-1]])
    draws = Draws(
        np.concatenate([computation, communication], axis=1),
        first,
        np.ones_like(first),
        np.zeros((1, 0, 0), dtype=np.int64),
        np.zeros((1, 0, 0), dtype=np.int64),
        np.zeros((0, len(first)), dtype=np.bool_),
    )
    times = empty_times(layout, 1, steps)
    if run_rows(steps, plan.rules(resolution), columns, draws, recorded, times) != DONE:
        raise TimingError("the measured times end before the last step of the supervisor")
    _put_windows(graph, layout, times, windows or {})
    return ComputationGraph(layout, resolution, steps, np.zeros(batch, dtype=np.int64), *times)


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
        times.windows[0, first : first + seen.size] = seen.ravel()


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

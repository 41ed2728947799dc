"""Timing: from rates and delays, drawn or recorded, to a computation graph.

Time is counted in integer ticks of 1/resolution seconds. The resolution is the smallest multiple of
10^9 per second in which every tick k/f, phase and constant delay of the graph is a whole number (30 Hz
makes it 3 * 10^9), so that comparisons of instants are exact; random delays are rounded to one tick.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import torch

from deepkoco.graph.computation_graph import ComputationGraph, Layout, layout_of
from deepkoco.graph.delay import Delay, Deterministic, exact_fraction, exact_seconds, make_delay
from deepkoco.graph.graph import Graph
from deepkoco.graph.timing_kernel import DONE, FULL, run_rows

Delays = Mapping[str, Any]
NANO = 10**9
_FINEST = 10**13  # ticks per second: beyond, int64 would not hold a day
_MOST_STRETCH = 64  # an episode that takes this many times its nominal steps is not going to end
_NEVER = np.iinfo(np.int64).max // 4


class TimingError(ValueError):
    """A timing cannot be drawn or replayed; the message says for which node or connection and why."""


def draw_timing(
    graph: Graph,
    generator: np.random.Generator | torch.Generator,
    steps: int,
    batch: int,
    delays: Delays | None = None,
    rows: int | None = None,
) -> ComputationGraph:
    """Draw delays and work out when every step runs and what it sees.

    The phases stay those of the graph's own delays, whatever `delays` says: a schedule does not know
    the delays that it will meet.

    Args:
        graph: nodes and connections with their delay laws.
        generator: where the draws come from.
        steps: supervisor steps to be taken; its next step, of which only the inputs count, ends the timing.
        batch: number of environments B, each with draws of its own.
        delays: overrides by node name (computation) or connection key "sender->receiver"
            (communication): anything that `make_delay` takes, or (B,) seconds, one constant for each
            environment.
        rows: number of different schedules, shared in turn by the environments; None: one for all
            environments where all delays are constant, else one for each.

    Returns:
        The computation graph of the batch.

    Raises:
        TimingError: an override names nothing in the graph, or is no delay.
    """
    if steps < 1 or batch < 1:
        raise TimingError(f"steps {steps} and batch {batch} must be at least 1")
    laws, constants = _delays(graph, delays or {}, batch)
    if rows is None:
        rows = 1 if all(law.constant for law in laws.values()) and not constants else batch
    if constants and rows != batch:
        raise TimingError(f"delays for each of {batch} environments need as many rows, not {rows}")
    streams = _streams(generator, tuple(laws))
    resolution = _resolution(graph, laws)
    capacity = planned = _capacity(graph, steps)
    drawn = {key: np.zeros((rows, 0), dtype=np.int64) for key in laws}
    while True:
        layout = layout_of(graph, capacity)
        sizes = {node.name: int(capacity[n]) for n, node in enumerate(graph.nodes)}
        sizes |= {c.key: int(capacity[graph.index[c.sender]]) for c in graph.connections}
        for key, law in laws.items():
            # What is drawn stays: to draw anew until the columns suffice would favour short delays.
            shape = rows, sizes[key] - drawn[key].shape[1]
            if key in constants:
                ticks = np.repeat(np.rint(constants[key] * resolution)[:, None], shape[1], axis=1)
            elif law.constant:
                ticks = np.full(shape, round(exact_seconds(law) * resolution))
            else:
                ticks = np.rint(law.sample(streams[key], shape) * resolution)
            drawn[key] = np.concatenate([drawn[key], ticks.astype(np.int64)], axis=1)
        nothing = np.zeros((rows, 0), dtype=np.int64)
        computation = np.concatenate([drawn[node.name] for node in graph.nodes], axis=1)
        communication = np.concatenate([nothing, *(drawn[c.key] for c in graph.connections)], axis=1)
        status, result = _run(graph, layout, resolution, steps, computation, communication, nothing)
        if status == DONE:
            row = np.arange(batch, dtype=np.int64) % rows
            return ComputationGraph(layout, resolution, steps, row, *result)
        if status != FULL:
            raise TimingError("no node can take its next step: blocking inputs wait for each other")
        capacity = capacity * 2
        if capacity.max() > _MOST_STRETCH * planned.max():
            raise TimingError(
                f'supervisor "{graph.supervisor}" does not come to its step {steps}: delays hold it up, or '
                "nodes with advance=True and only blocking inputs drive each other without any tick"
            )


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


def replay_timing(graph: Graph, measured: MeasuredTiming, batch: int = 1) -> ComputationGraph:
    """Put measured times in the place of drawn delays, under the same rules.

    The starts are the measured ones; what each step sees follows from the arrivals.

    Args:
        graph: the graph that ran.
        measured: times of one episode, in which the supervisor started at least two steps.
        batch: environments that all replay the episode.

    Raises:
        TimingError: times are missing, not finite, or run backwards.
    """
    laws, _ = _delays(graph, {}, batch)
    resolution = _resolution(graph, laws)
    start, end = {}, {}
    for node in graph.nodes:
        start[node.name] = _ticks(measured.t_start, node.name, resolution)
        end[node.name] = _ticks(measured.t_end, node.name, resolution, len(start[node.name]))
        previous = np.concatenate([[-_NEVER], end[node.name][:-1]])
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
    layout = layout_of(graph, capacity)
    computation = np.zeros((1, layout.step_base[-1]), dtype=np.int64)
    recorded = np.full((1, layout.step_base[-1]), _NEVER, dtype=np.int64)
    communication = np.full((1, layout.message_base[-1]), _NEVER, dtype=np.int64)
    for n, node in enumerate(graph.nodes):
        columns = slice(layout.step_base[n], layout.step_base[n] + len(start[node.name]))
        recorded[0, columns] = start[node.name]
        computation[0, columns] = end[node.name] - start[node.name]
    for e, connection in enumerate(graph.connections):
        sent = end[connection.sender]
        received = _ticks(measured.t_received, connection.key, resolution, len(sent), missing_at_end=True)
        bad = np.flatnonzero(received < sent[: len(received)])
        if len(bad):
            raise TimingError(f'connection "{connection.key}": message {bad[0]} arrives before it is sent')
        columns = slice(layout.message_base[e], layout.message_base[e] + len(received))
        communication[0, columns] = received - sent[: len(received)]
    status, result = _run(graph, layout, resolution, steps, computation, communication, recorded)
    if status != DONE:
        raise TimingError("the measured times end before the last step of the supervisor")
    return ComputationGraph(layout, resolution, steps, np.zeros(batch, dtype=np.int64), *result)


def _run(
    graph: Graph,
    layout: Layout,
    resolution: int,
    steps: int,
    computation: np.ndarray,
    communication: np.ndarray,
    recorded: np.ndarray,
) -> tuple[int, tuple[np.ndarray, ...]]:
    nodes, edges = graph.nodes, graph.connections
    rank = np.argsort(np.array(graph.order))
    ticks = [_nominal(node.rate, phase, resolution, size) for node, phase, size in _columns(graph, layout)]
    into = [graph.inputs_of(node.name) for node in nodes]
    nominal = [
        round((exact_seconds(graph.node(c.sender).delay) + exact_seconds(c.law)) * resolution)
        if c.jitter == "buffer"
        else -1
        for c in edges
    ]
    rows = len(computation)
    result = (
        np.zeros((rows, layout.step_base[-1]), dtype=np.int64),
        np.zeros((rows, layout.step_base[-1]), dtype=np.int64),
        np.zeros((rows, layout.message_base[-1]), dtype=np.int64),
        np.full((rows, layout.window_base[-1]), -1, dtype=np.int32),
        np.zeros((rows, steps + 1, len(nodes)), dtype=np.int32),
    )
    status = run_rows(
        steps,
        layout.supervisor,
        rank,
        _ancestors(graph),
        np.array([node.scheduling == "frequency" for node in nodes]),
        np.array(
            [n.advance and all(c.blocking for c in i) and i != () for n, i in zip(nodes, into, strict=True)]
        ),
        layout.step_base,
        layout.step_base[:-1] + np.arange(len(nodes)),
        np.concatenate(ticks),
        layout.sender,
        layout.receiver,
        np.array([c.skip for c in edges], dtype=np.bool_),
        np.array([c.blocking for c in edges], dtype=np.bool_),
        # Measured messages come in the order in which they came, lost ones never.
        np.array([c.fifo and recorded.shape[1] == 0 for c in edges], dtype=np.bool_),
        np.array(nominal, dtype=np.int64),
        layout.window,
        layout.message_base,
        layout.window_base,
        computation,
        communication,
        recorded,
        *result,
    )
    return status, result


def _columns(graph: Graph, layout: Layout) -> list[tuple[Any, Fraction, int]]:
    return list(zip(graph.nodes, graph.phases, np.diff(layout.step_base).tolist(), strict=True))


def _nominal(rate: Fraction, phase: Fraction, resolution: int, size: int) -> np.ndarray:
    """Nominal starts phase + k / rate [ticks], one more than `size`; rounded only where they must be."""
    first, period = phase * resolution, resolution / rate
    if first.denominator == 1 and period.denominator == 1:
        return int(first) + int(period) * np.arange(size + 1, dtype=np.int64)
    return np.array([round(first + k * period) for k in range(size + 1)], dtype=np.int64)


def _ancestors(graph: Graph) -> np.ndarray:
    reach = np.zeros((len(graph.nodes), len(graph.nodes)), dtype=np.bool_)
    for receiver in graph.order:
        for c in graph.inputs_of(graph.nodes[receiver].name):
            if not c.skip:
                reach[receiver] |= reach[graph.index[c.sender]]
                reach[receiver, graph.index[c.sender]] = True
    return reach


def _resolution(graph: Graph, laws: Mapping[str, Delay]) -> int:
    exact = [node.rate.numerator for node in graph.nodes] + [phase.denominator for phase in graph.phases]
    exact += [exact_fraction(law.mean).denominator for law in laws.values() if law.constant]
    finest = math.lcm(NANO, *exact)
    return finest if finest <= _FINEST else NANO


def _capacity(graph: Graph, steps: int) -> np.ndarray:
    supervisor = graph.index[graph.supervisor]
    seconds = graph.phases[supervisor] + steps / graph.nodes[supervisor].rate
    slack = 4 + seconds / 50  # overruns and waiting stretch the episode; beyond this columns are appended
    return np.array([math.ceil((seconds + slack / 100) * node.rate) + 8 for node in graph.nodes])


def _delays(graph: Graph, overrides: Delays, batch: int) -> tuple[dict[str, Delay], dict[str, np.ndarray]]:
    laws = {node.name: node.delay for node in graph.nodes} | {c.key: c.law for c in graph.connections}
    constants: dict[str, np.ndarray] = {}
    for key, override in overrides.items():
        if key not in laws:
            raise TimingError(f'delay of "{key}": no such node or connection; known: {", ".join(laws)}')
        if isinstance(override, (Delay, Mapping, int, float)):
            laws[key] = make_delay(override)
            continue
        values = np.asarray(override, dtype=np.float64)
        if values.shape != (batch,) or not np.isfinite(values).all() or (values < 0).any():
            raise TimingError(f'delay of "{key}": expected {batch} finite numbers of seconds >= 0, one each')
        if (values == values[0]).all():
            laws[key] = Deterministic(float(values[0]))
        else:
            constants[key] = values
    return laws, constants


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
    if size is not None and (len(seconds) > size or (len(seconds) < size and not missing_at_end)):
        raise TimingError(f'"{name}" has {len(seconds)} measured times for {size} steps')
    if np.isnan(seconds).any():
        raise TimingError(f'"{name}": measured time {np.flatnonzero(np.isnan(seconds))[0]} is not a number')
    lost = ~np.isfinite(seconds)
    return np.where(lost, _NEVER, np.rint(np.where(lost, 0.0, seconds) * resolution)).astype(np.int64)


def _streams(
    generator: np.random.Generator | torch.Generator, keys: tuple[str, ...]
) -> dict[str, np.random.Generator]:
    """A generator for each node and connection, so that further draws of one leave the others as they are."""
    if isinstance(generator, torch.Generator):
        seed = int(torch.randint(2**62, (), generator=generator))
    else:
        seed = int(generator.integers(2**62))
    children = np.random.SeedSequence(seed).spawn(len(keys))
    return {key: np.random.default_rng(child) for key, child in zip(keys, children, strict=True)}

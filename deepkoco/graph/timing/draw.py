"""Timing: from rates and delay laws to a computation graph.

Time is counted in integer ticks of 1/resolution seconds. The resolution is the smallest multiple of
10^9 per second in which every tick k/f, phase and constant delay of the graph is a whole number (30 Hz
makes it 3 * 10^9), so that comparisons of instants are exact; random delays are rounded to one tick.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch

from deepkoco.graph.delay import DelayError, RankCorrelation, RecordedDelays, Stalls
from deepkoco.graph.model.graph import Graph, check_coupling
from deepkoco.graph.timing.computation_graph import ComputationGraph
from deepkoco.graph.timing.drawn import DrawnDelays
from deepkoco.graph.timing.kernel import DONE, FULL, UNSTALLED, run_rows
from deepkoco.graph.timing.origin import Origin
from deepkoco.graph.timing.overrides import ChannelLaws, Delays, TimingError, read_overrides
from deepkoco.graph.timing.plan import plan_of
from deepkoco.graph.timing.rule_tables import Draws, Measured, Times
from deepkoco.graph.timing.waiting import Waiting

__all__ = ["Delays", "TimingError", "draw_timing", "extend_timing"]
_AT_ONCE = 100_000  # steps of nodes that are worked out between two looks at the clock
MOST_STRETCH = 64  # an episode that takes this many times its nominal steps is not going to end


def draw_timing(
    graph: Graph,
    generator: np.random.Generator | torch.Generator,
    steps: int,
    batch: int,
    delays: Delays | None = None,
    rows: int | None = None,
    *,
    correlations: Iterable[RankCorrelation | Mapping[str, Any]] | None = None,
    stalls: Iterable[Stalls | Mapping[str, Any]] | None = None,
    traces: RecordedDelays | None = None,
) -> ComputationGraph:
    """Draw delays and work out when every step runs and what it sees.

    The phases stay those of the graph's own delays, whatever `delays` says: a schedule does not know
    the delays that it will meet. More steps from the same generator state begin with the same timing.

    Args:
        graph: nodes and connections with their delay laws.
        generator: where the draws come from; one number is drawn from it.
        steps: supervisor steps to be taken; its next step, of which only the inputs count, ends the timing.
        batch: number of environments B.
        delays: overrides by node name (computation) or connection key "sender->receiver"
            (communication): anything that `make_delay` takes; (R,) seconds, one constant for each
            schedule; a description whose numbers are (R,) arrays; or R laws. R is `rows` if that is given,
            else B.
        rows: number R of different schedules, taken in turn by the environments; None: one for all
            environments where all delays are constant, else one for each. There may be more than
            environments: schedules for episodes to come.
        correlations, stalls: in the place of those of the graph.
        traces: recordings that are played in the place of the laws of their channels.

    Returns:
        The computation graph of the batch.

    Raises:
        TimingError: an override names nothing in the graph, or is no delay; or `generator` is none.
    """
    if steps < 1 or batch < 1 or (rows is not None and rows < 1):
        raise TimingError(f"steps {steps}, batch {batch} and rows {rows} must be at least 1")
    laws = laws_of(graph, delays or {}, rows or batch, traces)
    coupled = graph.correlations, graph.stalls
    if correlations is not None or stalls is not None:
        try:
            coupled = check_coupling(
                graph,
                coupled[0] if correlations is None else correlations,
                coupled[1] if stalls is None else stalls,
            )
        except DelayError as error:
            raise TimingError(str(error)) from error
    if rows is None:
        rows = 1 if laws.constant and not coupled[1] else batch
    origin = Origin(graph, draw_seed(generator), laws, *coupled, rows, None)
    return _work_out(origin, steps, np.arange(batch, dtype=np.int64) % rows)


def extend_timing(timing: ComputationGraph, steps: int) -> ComputationGraph:
    """Draw a timing again with more supervisor steps: what was is as it was, then it goes on.

    Raises:
        TimingError: the timing was not drawn but measured, or put together from several, or is not shorter.
    """
    if not isinstance(timing.origin, Origin):
        raise TimingError("only a timing from draw_timing can be extended; this one was measured or joined")
    if steps < timing.steps:
        raise TimingError(f"the timing has {timing.steps} steps already; {steps} are fewer")
    return _work_out(timing.origin, steps, timing.row)


def laws_of(graph: Graph, delays: Delays, rows: int, traces: RecordedDelays | None = None) -> ChannelLaws:
    """Return where the delays of a graph's channels come from, `delays` in the place of its own laws.

    Raises:
        TimingError: an override names nothing in the graph, or is no delay.
    """
    plan = plan_of(graph)
    own = dict(zip(plan.channels, plan.laws, strict=True))
    return read_overrides(own, plan.channels[: len(graph.nodes)], delays, rows, traces)


def draw_seed(generator: np.random.Generator | torch.Generator) -> int:
    """Draw the number from which all delays of a timing follow.

    Raises:
        TimingError: it is no generator.
    """
    if isinstance(generator, torch.Generator):
        return int(torch.randint(2**62, (), generator=generator))
    if isinstance(generator, np.random.Generator):
        return int(generator.integers(2**62))
    raise TimingError(
        f"generator {generator!r} is no generator; give np.random.default_rng(SEED) or "
        "torch.Generator().manual_seed(SEED)"
    )


def resolution_of(origin: Origin) -> int:
    """Return the ticks per second of a timing with these delays."""
    plan = plan_of(origin.graph)
    return plan.resolution(law for key, law in origin.laws.same.items() if law is not _own(plan, key))


def _work_out(origin: Origin, steps: int, row: np.ndarray) -> ComputationGraph:
    graph, plan = origin.graph, plan_of(origin.graph)
    resolution = resolution_of(origin)
    rules = plan.rules(resolution)
    capacity = planned = plan.capacity(steps)
    drawn = DrawnDelays(graph, origin, resolution)
    while True:
        layout, columns = plan.columns(capacity, resolution)
        draws = drawn.up_to(capacity)
        times = empty_times(layout, len(drawn.kept), steps)
        status = _run(steps, rules, columns, draws, times)
        if status == DONE:
            return ComputationGraph(layout, resolution, steps, row, *times, origin=origin)
        if status == UNSTALLED:
            drawn.draw_stalls()
            continue
        if status != FULL:
            raise TimingError("no node can take its next step: blocking inputs wait for each other")
        capacity = capacity * 2
        if capacity.max() > MOST_STRETCH * planned.max():
            raise TimingError(
                f'supervisor "{graph.supervisor}" does not come to its step {steps}: delays hold it up, or '
                "nodes with advance=True and only blocking inputs drive each other without any tick"
            )


def _run(steps: int, rules: Any, columns: Any, draws: Draws, times: Times) -> int:
    """Fill the times of all schedules, a part of them at a time so that who waits can see how far it is."""
    flags = np.zeros(len(rules.rank), dtype=np.bool_), np.zeros(len(rules.sender), dtype=np.bool_)
    nothing = Measured(np.zeros(0, dtype=np.int64), *flags)
    rows, size = len(draws.values), max(1, _AT_ONCE // max(1, times.t_start.shape[1]))
    with Waiting("drawing schedules", rows) as waiting:
        for first in range(0, rows, size):
            part = slice(first, first + size)
            own = draws._replace(
                values=draws.values[part],
                stall_begin=draws.stall_begin[part],
                stall_end=draws.stall_end[part],
            )
            status = run_rows(steps, rules, columns, own, nothing, Times(*(t[part] for t in times)))
            if status != DONE:
                return status
            waiting.advance(len(own.values))
    return DONE


def empty_times(layout: Any, rows: int, steps: int) -> Times:
    """Return arrays for the kernel to fill."""
    return Times(
        np.zeros((rows, layout.step_base[-1]), dtype=np.int64),
        np.zeros((rows, layout.step_base[-1]), dtype=np.int64),
        np.zeros((rows, layout.message_base[-1]), dtype=np.int64),
        np.full((rows, layout.window_base[-1]), -1, dtype=np.int32),
        np.zeros((rows, steps + 1, len(layout.names)), dtype=np.int32),
    )


def _own(plan: Any, key: str) -> Any:
    return plan.laws[plan.places[key]]

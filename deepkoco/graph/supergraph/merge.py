"""Merging: one sequence of slots into which the steps of all schedules fit, and which slot runs what."""

from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.embedding import grow
from deepkoco.graph.supergraph.partition import AHEAD, GraphCycleError, partition_timing
from deepkoco.graph.supergraph.search import find_slots
from deepkoco.graph.timing.computation_graph import ComputationGraph

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "42efd0a1e8a16b07"

EFFORT = 30
"""Effort of the search for the slots of a timing; it runs where someone waits for an environment."""


class MergedSlots(NamedTuple):
    """Slots common to all schedules of a computation graph.

    A step runs in the pass in which it starts, one earlier, or as many later as nobody needs it: what has
    run before a supervisor step is in `executed`, not in `ComputationGraph.boundary`. Other slots may have run
    other steps by then: what is running keeps its table, see `join_slots`.

    Attributes:
        slots: (L,) node that runs in each slot, in this order, before each supervisor step.
        table: (R, steps + 1, L) int32 seq that a slot runs before supervisor step k of a schedule, -1 for none.
        depth: (N,) how many of its last outputs a node must keep for its receivers.
        executed: (R, steps + 1, N) int32 number of steps of each node that have run when supervisor step k comes.
    """

    slots: np.ndarray
    table: np.ndarray
    depth: np.ndarray
    executed: np.ndarray

    def take(self, rows: np.ndarray) -> "MergedSlots":
        """Return the tables of some schedules."""
        return self._replace(table=self.table[rows], executed=self.executed[rows])


def merge_slots(
    timing: ComputationGraph, slots: np.ndarray | None = None, effort: int = EFFORT
) -> MergedSlots:
    """Find slots for the schedules of a timing, and work out which slot runs which step.

    Args:
        timing: what starts when and sees what.
        slots: (L,) slots to use; more are put in between where a schedule does not fit. None searches.
        effort: of the search, see `find_slots`.

    Returns:
        The slots and their tables. The same timing and slots give the same tables, whatever else there is
        in the batch, as long as no slot had to be added.

    Raises:
        GraphCycleError: the computation graph has a cycle.
    """
    if slots is None:
        slots = find_slots(partition_timing(timing), effort)
    merged, fits = _fill(timing, np.asarray(slots, np.int64))
    if not fits:
        merged, fits = _fill(timing, grow(partition_timing(timing), slots).astype(np.int64))
        if not fits:
            raise GraphCycleError("the computation graph does not fit in slots made for it")
    return merged


def join_slots(running: MergedSlots, fresh: MergedSlots) -> MergedSlots:
    """Put the tables of two timings of the same graph one below the other.

    What is running keeps its tables, so that nothing runs twice or not at all.

    Args:
        running: tables of any schedules.
        fresh: made by `merge_slots` with the slots of `running`, of as many supervisor steps.
    """
    column, columns = 0, []
    for kind in running.slots.tolist():
        while column < len(fresh.slots) and fresh.slots[column] != kind:
            column += 1
        columns.append(column)
        column += 1
    if column > len(fresh.slots):
        raise ValueError("the slots of the fresh schedules do not contain those of the running ones")
    table = np.full(
        (*running.table.shape[:2], len(fresh.slots)), -1, dtype=np.result_type(running.table, fresh.table)
    )
    table[:, :, columns] = running.table
    return MergedSlots(
        fresh.slots,
        np.concatenate([table, fresh.table]),
        np.maximum(running.depth, fresh.depth),
        np.concatenate([running.executed, fresh.executed]),
    )


def _fill(timing: ComputationGraph, slots: np.ndarray) -> tuple[MergedSlots, bool]:
    layout = timing.layout
    rows, passes, nodes = timing.boundary.shape
    order = np.argsort(layout.receiver, kind="stable")
    table = np.full((rows, passes, len(slots)), -1, dtype=np.int32)
    executed, depth = np.zeros((rows, passes, nodes), dtype=np.int32), np.ones(nodes, dtype=np.int64)
    fits = _run_passes(
        slots,
        layout.supervisor,
        np.searchsorted(layout.receiver[order], np.arange(nodes + 1)),
        layout.sender[order],
        layout.window[order],
        layout.window_base[:-1][order],
        timing.windows,
        timing.boundary,
        table,
        executed,
        depth,
    )
    return MergedSlots(slots, table, depth, executed), bool(fits)


@njit(cache=True)
def _run_passes(
    slots,  # (L,)
    supervisor,
    into,  # (N + 1,) connections into node n are into[n] to into[n + 1]
    sender,  # (E,) by receiver, like the next two
    window,
    window_base,
    windows,  # (R, windows) seqs seen
    boundary,  # (R, passes, N) steps of each node that start before each supervisor step
    table,  # (R, passes, L) out, filled with -1
    executed,  # (R, passes, N) out
    depth,  # (N,) out, filled with 1
):
    """Run every step in the first slot that it can have; return whether nothing came too late."""
    rows, passes, nodes = boundary.shape
    at = np.zeros(nodes, np.int64)
    for row in range(rows):
        at[:] = 0
        for j in range(passes):
            may = boundary[row, min(j + AHEAD, passes - 1)]
            for s in range(len(slots)):
                n = slots[s]
                if at[n] < may[n] and _sees(n, row, at, into, sender, window, window_base, windows, depth):
                    table[row, j, s] = at[n]
                    at[n] += 1
            executed[row, j] = at
            if not _sees(supervisor, row, at, into, sender, window, window_base, windows, depth):
                return False
            at[supervisor] += 1
        for n in range(nodes):
            if n != supervisor and at[n] < boundary[row, passes - 1, n]:
                return False
    return True


@njit(cache=True)
def _sees(n, row, at, into, sender, window, window_base, windows, depth):
    """Whether all messages that a node's next step sees are there; notes how far back it looks."""
    for e in range(into[n], into[n + 1]):
        base = window_base[e] + at[n] * window[e]
        for i in range(window[e]):
            if windows[row, base + i] >= at[sender[e]]:
                return False
    for e in range(into[n], into[n + 1]):
        base = window_base[e] + at[n] * window[e]
        for i in range(window[e]):
            depth[sender[e]] = max(depth[sender[e]], at[sender[e]] - windows[row, base + i])
    return True

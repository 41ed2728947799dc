"""Merging: one sequence of slots into which the steps of all schedules fit.

Between two steps of the supervisor, every schedule runs its own steps in its own order. A slot runs one
node for all environments that have a step of it ready; the sequence of slots is chosen so that the steps
of every schedule, between any two supervisor steps, fit into it in an order that respects who needs whose
message.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.graph.computation_graph import ComputationGraph


class MergedSlots(NamedTuple):
    """Slots common to all schedules of a computation graph.

    Attributes:
        slots: (L,) node that runs in each slot, in this order, before each supervisor step.
        table: (R, steps + 1, L) int32 seq that a slot runs before supervisor step k of a schedule, -1 for none.
        depth: (N,) how many of its last outputs a node must keep for its receivers.
    """

    slots: np.ndarray
    table: np.ndarray
    depth: np.ndarray


def merge_slots(timing: ComputationGraph) -> MergedSlots:
    """Choose slots greedily: the node for which most intervals have a step ready comes next.

    Raises:
        RuntimeError: the computation graph has a cycle.
    """
    layout = timing.layout
    rows, intervals, nodes = timing.boundary.shape
    begin = np.zeros_like(timing.boundary)
    begin[:, 1:] = timing.boundary[:, :-1]
    begin[:, :, layout.supervisor] = timing.boundary[:, :, layout.supervisor]  # acts from outside
    at = begin.reshape(-1, nodes).astype(np.int64)
    limit = timing.boundary.reshape(-1, nodes).astype(np.int64)
    columns = (
        layout.sender,
        layout.receiver,
        layout.window,
        layout.window_base,
        timing.windows,
        intervals,
    )
    depth = np.ones(nodes, dtype=np.int64)
    slots, table = [], []
    ready = count_ready(at, limit, *columns)
    while ready.any():
        slots.append(int(ready.argmax()))
        table.append(run_slot(slots[-1], at, limit, depth, *columns))
        ready = count_ready(at, limit, *columns)
    if (at < limit).any():
        raise RuntimeError("a step needs a message that is sent later: the computation graph has a cycle")
    read_by_supervisor(layout.supervisor, at, depth, *columns)
    columns_last = np.array(table, dtype=np.int32).reshape(len(slots), rows, intervals).transpose(1, 2, 0)
    return MergedSlots(np.array(slots, dtype=np.int64), np.ascontiguousarray(columns_last), depth)


@njit(cache=True)
def _is_ready(node, interval, at, limit, sender, receiver, window, window_base, windows, intervals):
    step = at[interval, node]
    if step >= limit[interval, node]:
        return False
    row = interval // intervals
    for e in range(len(sender)):
        if receiver[e] == node:
            for i in range(window[e]):
                if windows[row, window_base[e] + step * window[e] + i] >= at[interval, sender[e]]:
                    return False
    return True


@njit(cache=True)
def _needed_depth(node, interval, at, depth, sender, receiver, window, window_base, windows, intervals):
    row, step = interval // intervals, at[interval, node]
    for e in range(len(sender)):
        if receiver[e] == node:
            for i in range(window[e]):
                age = at[interval, sender[e]] - windows[row, window_base[e] + step * window[e] + i]
                depth[sender[e]] = max(depth[sender[e]], age)


@njit(cache=True)
def count_ready(at, limit, sender, receiver, window, window_base, windows, intervals):
    """Count for each node the intervals in which its next step has all its messages, (N,)."""
    ready = np.zeros(at.shape[1], np.int64)
    for interval in range(at.shape[0]):
        for node in range(at.shape[1]):
            ready[node] += _is_ready(
                node, interval, at, limit, sender, receiver, window, window_base, windows, intervals
            )
    return ready


@njit(cache=True)
def run_slot(node, at, limit, depth, sender, receiver, window, window_base, windows, intervals):
    """Run a node's next step wherever it is ready; return its seq in each interval, -1 where it is not."""
    column = np.full(at.shape[0], -1, np.int32)
    for interval in range(at.shape[0]):
        if _is_ready(node, interval, at, limit, sender, receiver, window, window_base, windows, intervals):
            _needed_depth(
                node, interval, at, depth, sender, receiver, window, window_base, windows, intervals
            )
            column[interval] = at[interval, node]
            at[interval, node] += 1
    return column


@njit(cache=True)
def read_by_supervisor(supervisor, at, depth, sender, receiver, window, window_base, windows, intervals):
    """Account for the messages that the supervisor sees at the end of each interval."""
    for interval in range(at.shape[0]):
        _needed_depth(
            supervisor, interval, at, depth, sender, receiver, window, window_base, windows, intervals
        )

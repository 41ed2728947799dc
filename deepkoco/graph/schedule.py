"""Schedules: the slots of a computation graph and its tables, where the runtime looks them up."""

import numpy as np
import torch

from deepkoco.graph.computation_graph import ComputationGraph
from deepkoco.graph.supergraph import merge_slots


class Schedule:
    """The slots of a computation graph.

    Attributes:
        timing: the computation graph.
        slots: (L,) node that runs in each slot.
        table: (R, steps + 1, L) seq that a slot runs before supervisor step k of a schedule, -1 for none.
        depth: (N,) how many of its last outputs a node must keep for its receivers.
        t_start: (R, steps of all nodes) float64 [s].
        seq, t_sent, t_received: (R, windows of all connections) the messages that each step sees, int64
            and float64 [s], in the columns of `ComputationGraph.windows`.
    """

    def __init__(self, timing: ComputationGraph, device: torch.device | str = "cpu") -> None:
        self.timing = timing
        self.slots, self.table, self.depth = merge_slots(timing)
        self._every_row = np.arange(len(timing.boundary))
        self.t_start = torch.from_numpy(timing.t_start / timing.resolution).to(device)
        seq = timing.windows.astype(np.int64)
        sent, received = _window_times(timing)
        self.seq = torch.from_numpy(seq).to(device)
        self.t_sent = torch.from_numpy(sent).to(device)
        self.t_received = torch.from_numpy(received).to(device)

    def direct(self, row: np.ndarray) -> bool:
        """Return whether environment b runs row b, or all run the only row."""
        return len(self._every_row) == 1 or np.array_equal(row, self._every_row)


def _window_times(timing: ComputationGraph) -> tuple[np.ndarray, np.ndarray]:
    """Times of the messages in all windows [s], minus infinity for an initial output."""
    layout = timing.layout
    width = np.diff(layout.window_base)
    step, message = (
        np.repeat(layout.step_base[layout.sender], width),
        np.repeat(layout.message_base[:-1], width),
    )
    place = np.maximum(timing.windows, 0)
    initial = timing.windows < 0
    sent = np.take_along_axis(timing.t_end, step + place, axis=1) / timing.resolution
    received = np.take_along_axis(timing.t_received, message + place, axis=1) / timing.resolution
    return np.where(initial, -np.inf, sent), np.where(initial, -np.inf, received)

"""Schedules: the slots of a computation graph and its tables, where the executors look them up."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.supergraph import MergedSlots, merge_slots
from deepkoco.graph.timing.computation_graph import ComputationGraph


class Tables(NamedTuple):
    """The computation graph's arrays with the types that the compiled kernels read; copied only to convert."""

    slots: np.ndarray
    windows: np.ndarray
    t_start: np.ndarray
    t_end: np.ndarray
    t_received: np.ndarray


class Schedule:
    """The slots of a computation graph.

    Args:
        timing: the computation graph.
        device: where the tensors of the eager executor live.
        merged: its slots, if they are known already.

    Attributes:
        merged: slots and tables as they were found.
        slots: (L,) node that runs in each slot.
        table: (R, steps + 1, L) int16 or int32 seq that a slot runs before supervisor step k of a schedule,
            -1 for none.
        depth: (N,) how many of its last outputs a node must keep for its receivers.
        executed: (R, steps + 1, N) steps of each node that have run when supervisor step k comes.
    """

    def __init__(
        self, timing: ComputationGraph, device: torch.device | str = "cpu", merged: MergedSlots | None = None
    ) -> None:
        self.timing, self.device = timing, device
        merged = merge_slots(timing) if merged is None else merged
        self.merged = merged._replace(table=_compact(merged.table), executed=_compact(merged.executed))
        self.slots, self.table, self.depth, self.executed = self.merged
        self._every_row = np.arange(self.rows)

    @property
    def rows(self) -> int:
        """Number of different schedules R."""
        return len(self.timing.boundary)

    def direct(self, row: np.ndarray) -> bool:
        """Return whether environment b runs row b, or all run the only row."""
        return self.rows == 1 or np.array_equal(row, self._every_row)

    @cached_property
    def tables(self) -> Tables:
        timing = self.timing
        return Tables(
            np.ascontiguousarray(self.slots, dtype=np.int32),
            np.ascontiguousarray(timing.windows, dtype=np.int32),
            *(
                np.ascontiguousarray(t, dtype=np.int64)
                for t in (timing.t_start, timing.t_end, timing.t_received)
            ),
        )

    @cached_property
    def t_start(self) -> Tensor:
        """(R, steps of all nodes) float64 [s]."""
        return torch.from_numpy(self.timing.t_start / self.timing.resolution).to(self.device)

    @cached_property
    def seq(self) -> Tensor:
        """(R, windows of all connections) int64 messages that each step sees."""
        return torch.from_numpy(self.timing.windows.astype(np.int64)).to(self.device)

    @cached_property
    def t_sent(self) -> Tensor:
        """Ends of the steps that sent the messages in all windows, float64 [s]; -inf for initial outputs."""
        timing, layout = self.timing, self.timing.layout
        return self._times(timing.t_end, layout.step_base[layout.sender])

    @cached_property
    def t_received(self) -> Tensor:
        """Arrivals of the messages in all windows, float64 [s]; -inf for initial outputs."""
        return self._times(self.timing.t_received, self.timing.layout.message_base[:-1])

    def _times(self, ticks: np.ndarray, base: np.ndarray) -> Tensor:
        windows = self.timing.windows
        place = np.repeat(base, np.diff(self.timing.layout.window_base)) + np.maximum(windows, 0)
        times = np.take_along_axis(ticks, place, axis=1) / self.timing.resolution
        return torch.from_numpy(np.where(windows < 0, -np.inf, times)).to(self.device)


def _compact(numbers: np.ndarray) -> np.ndarray:
    """The numbers in 16 bits where they fit."""
    small = numbers.size == 0 or int(numbers.max()) <= np.iinfo(np.int16).max
    return np.ascontiguousarray(numbers, dtype=np.int16 if small else np.int32)

"""Kernels with a way back, and what Python hands to them."""

import ctypes

import numpy as np

from deepkoco.graph.execution.fused.kernel import Kernel
from deepkoco.graph.execution.fused.program import Program
from deepkoco.graph.execution.fused.source import KernelSource
from deepkoco.graph.model.graph import Graph

LOG = np.dtype(
    [(n, np.int64) for n in ("first", "states", "state_bytes", "outputs", "output_bytes", "stride")]
    + [(n, np.int64) for n in ("map", "bars", "history")]
    + [(n, np.int32) for n in ("depth", "differs", "mask", "unused")]
)
"""Where the tape of a node lies, as `tape.h` reads it."""


class TapeStruct(ctypes.Structure):
    """A tape, as `tape.h` reads it."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name in ("log", "done", "runs", "memory")]
        + [(name, ctypes.c_int64) for name in ("block_bytes", "starts")]
    )  # fmt: skip


class PullStruct(ctypes.Structure):
    """Cotangents that are given and found, as `reverse.h` reads them."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name in ("readings", "end", "begin")]
        + [("record_bytes", ctypes.c_int64), ("fixed", ctypes.c_void_p), ("actions", ctypes.c_void_p)]
    )  # fmt: skip


class AdjointKernel(Kernel):
    """A compiled graph whose rollouts can leave a tape, and the way back over it.

    Args:
        graph: nodes and connections.
        programs: their traces, made where gradients are wanted.
        source: the C++ of `adjoint_source`.
    """

    def __init__(self, graph: Graph, programs: list[Program], source: KernelSource) -> None:
        super().__init__(graph, programs, source)
        pointer = ctypes.c_void_p
        self.record, self.reverse = self.library.record, self.library.reverse
        self.record.argtypes, self.record.restype = [pointer] * 6, ctypes.c_int64
        self.reverse.argtypes, self.reverse.restype = [pointer] * 7, None

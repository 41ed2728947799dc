"""Gradient steps on a GPU, recorded once for each shape of a batch and started again as a whole."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

WARM_UPS = 3  # steps before a capture, in which libraries allocate and choose what they do lazily
Step = Callable[[Sequence[Tensor], Any], Tensor]
"""From the parts of a batch and the key."""


class CapturedStep:
    """A step on fixed tensors, captured as a CUDA graph.

    A network of this size needs some hundred kernels a step, each of which takes the GPU less time than its launch
    takes Python: launched as one graph, they follow each other without a gap. The kernels are the same. The first
    steps with a shape run one by one; they count as steps like all others.
    """

    def __init__(self, step: Step, device: str) -> None:
        """Keep what is to be captured.

        Args:
            step: Called with tensors on the device and the key; changes in place whatever it changes, and returns
                one tensor. It must not read a value on the host.
            device: A CUDA device.
        """
        self._step, self._device = step, torch.device(device)
        self._runs: dict[Any, int] = {}
        self._graphs: dict[Any, tuple[torch.cuda.CUDAGraph, list[Tensor], Tensor]] = {}
        self._refused = False

    def forget(self) -> None:
        """Drop what was captured: the tensors that a step changes are others now."""
        self._runs.clear()
        self._graphs.clear()

    def __call__(self, parts: Sequence[Tensor], key: Any) -> Tensor:
        """Make a step.

        Args:
            parts: What the step is called with, on any device.
            key: A hashable value that the step is called with too, and that decides what it does.

        Returns:
            What the step returned, in memory of its own.
        """
        kind = key, tuple((part.shape, part.dtype) for part in parts)
        if kind not in self._graphs:
            placed = [part.to(self._device) for part in parts]
            if self._refused or self._runs.get(kind, 0) < WARM_UPS:
                self._runs[kind] = self._runs.get(kind, 0) + 1
                return self._alone(placed, key)
            try:
                self._graphs[kind] = self._capture([part.clone() for part in placed], key)
            except RuntimeError as error:
                self._refused = True
                warnings.warn(
                    "training on the GPU goes on kernel by kernel, which is slower: a step cannot be captured "
                    f"({error})",
                    stacklevel=3,
                )
                return self._alone(placed, key)
        graph, own, result = self._graphs[kind]
        for target, part in zip(own, parts, strict=True):
            target.copy_(part, non_blocking=True)
        graph.replay()
        return result.clone()

    def _alone(self, parts: Sequence[Tensor], key: Any) -> Tensor:
        """Step on a stream of its own, as a capture needs it before."""
        here, side = torch.cuda.current_stream(self._device), torch.cuda.Stream(self._device)
        side.wait_stream(here)
        with torch.cuda.stream(side):
            result = self._step(parts, key)
        here.wait_stream(side)
        return result

    def _capture(self, parts: list[Tensor], key: Any) -> tuple[torch.cuda.CUDAGraph, list[Tensor], Tensor]:
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.device(self._device), torch.cuda.graph(graph):
            result = self._step(parts, key)
        return graph, parts, result

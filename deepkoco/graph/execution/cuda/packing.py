"""Packing: tensors of several names in one buffer per type, so that copying them all is a few operations."""

from collections.abc import Mapping
from math import prod

import torch
from torch import Tensor

Name = tuple[str, ...]
Specs = Mapping[Name, tuple[torch.dtype, tuple[int, ...]]]
Buffers = dict[torch.dtype, Tensor]
ALIGNED = 16  # bytes that a tensor begins at a multiple of, for wide loads


def specs_of(tensors: Mapping[Name, Tensor]) -> dict[Name, tuple[torch.dtype, tuple[int, ...]]]:
    """Types and shapes by name."""
    return {name: (tensor.dtype, tuple(tensor.shape)) for name, tensor in tensors.items()}


class Packing:
    """Where tensors lie in the buffers of their types.

    Args:
        specs: type and shape by name.
    """

    def __init__(self, specs: Specs) -> None:
        self.specs = dict(specs)
        self._offset: dict[Name, int] = {}
        self._size: dict[torch.dtype, int] = {}
        for name, (dtype, shape) in self.specs.items():
            self._offset[name] = start = self._size.get(dtype, 0)
            step = ALIGNED // min(ALIGNED, dtype.itemsize)
            self._size[dtype] = start + -(-prod(shape) // step) * step

    def allocate(self, device: torch.device) -> Buffers:
        """Buffers of zeros."""
        return {dtype: torch.zeros(size, dtype=dtype, device=device) for dtype, size in self._size.items()}

    def views(self, buffers: Buffers) -> dict[Name, Tensor]:
        """The tensors in the buffers, by name."""
        return {name: self.view(buffers, name) for name in self.specs}

    def view(self, buffers: Buffers, name: Name) -> Tensor:
        """One tensor in the buffers."""
        dtype, shape = self.specs[name]
        start = self._offset[name]
        return buffers[dtype][start : start + prod(shape)].view(shape)

    def pack(self, tensors: Mapping[Name, Tensor], device: torch.device) -> Buffers:
        """Copy tensors into new buffers."""
        buffers = self.allocate(device)
        for name, view in self.views(buffers).items():
            view.copy_(tensors[name])
        return buffers


def load(target: Buffers, source: Buffers) -> None:
    """Copy all numbers of one set of buffers into another of the same packing."""
    for dtype, buffer in target.items():
        buffer.copy_(source[dtype])


def clone(buffers: Buffers) -> Buffers:
    """Buffers of their own with the same numbers."""
    return {dtype: buffer.clone() for dtype, buffer in buffers.items()}

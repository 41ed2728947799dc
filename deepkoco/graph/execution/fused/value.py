"""Traced tensors in C++: the names of their elements, or where they lie in memory."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from deepkoco.graph.execution.fused.trace import TraceError

REGISTERS = 32
VECTORS = {torch.float32: "VF", torch.float64: "VD", torch.int64: "VL", torch.int32: "VI", torch.bool: "VB"}
SCALARS = {
    torch.float32: "float",
    torch.float64: "double",
    torch.int64: "i64",
    torch.int32: "i32",
    torch.bool: "u8",
}


@dataclass(frozen=True)
class Array:
    """Elements in memory, strided like a torch tensor.

    Attributes:
        pointer: C++ expression.
        kind: "lanes": a record of the block, an element is a lane vector; "local": an array of lane
            vectors; "shared": numbers that all environments share.
        strides: [elements] per dimension.
        offset: [elements].
    """

    pointer: str
    kind: str
    strides: tuple[int, ...]
    offset: int = 0

    def at(self, index: str, dtype: torch.dtype) -> str:
        """C++ expression of the element at a flat index."""
        if self.kind == "local":
            return f"{self.pointer}[{index}]"
        if self.kind == "shared":
            return f"splat<{VECTORS[dtype]}>({self.pointer}[{index}])"
        return f"ld<{VECTORS[dtype]}>({self.pointer}, {index})"


@dataclass(frozen=True)
class Value:
    """A traced tensor: the names of its elements, or where they lie in memory."""

    shape: tuple[int, ...]
    dtype: torch.dtype
    elements: tuple[str, ...] = ()
    array: Array | None = None

    @property
    def size(self) -> int:
        return math.prod(self.shape)


def supported(dtype: torch.dtype) -> torch.dtype:
    """The type itself, if lanes can hold it."""
    if dtype not in VECTORS:
        raise TraceError(f"tensors of type {dtype} are not compiled")
    return dtype


def number_text(number: float | bool, dtype: torch.dtype) -> str:
    if dtype == torch.bool:
        return "-1" if number else "0"
    if not dtype.is_floating_point:
        return f"{int(number)}LL" if dtype == torch.int64 else str(int(number))
    suffix = "f" if dtype == torch.float32 else ""
    number = float(torch.tensor(float(number), dtype=dtype))
    if math.isnan(number):
        return f'__builtin_nan{suffix}("")'
    if math.isinf(number):
        return f"{'-' if number < 0 else ''}__builtin_inf{suffix}()"
    return f"{number.hex()}{suffix}"


def contiguous(shape: Sequence[int]) -> tuple[int, ...]:
    return tuple(math.prod(shape[i + 1 :]) for i in range(len(shape)))


def flat_indices(value: Value) -> list[int]:
    """Flat indices of the elements of a value in memory."""
    assert value.array is not None
    index = torch.full((), value.array.offset)
    for size, stride in zip(value.shape, value.array.strides, strict=True):
        index = index[..., None] + torch.arange(size) * stride
    return index.flatten().tolist()


def loops_over(shape: Sequence[int]) -> tuple[str, list[str]]:
    """Nested loops over a shape, and the index of each dimension."""
    index = [f"i{d}" if size > 1 else "0" for d, size in enumerate(shape)]
    loops = [f"for (int i{d} = 0; i{d} < {size}; i{d}++)" for d, size in enumerate(shape) if size > 1]
    if loops:
        loops[-1] = f"LOOP {loops[-1]}"
    return " ".join(loops), index


def position(array: Array, index: Sequence[str]) -> str:
    terms = [str(array.offset)] if array.offset else []
    terms += [
        f"{i} * {stride}" if stride != 1 else i
        for i, stride in zip(index, array.strides, strict=True)
        if i != "0" and stride != 0
    ]
    return " + ".join(terms) or "0"

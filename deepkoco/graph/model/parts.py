"""Parts: the output of a node that puts out several tensors, and how they travel as one.

A node declares them: ``outputs = {"picture": ((64, 64, 3), torch.uint8), "stamp": ((), torch.float64)}``. Its
`initial_output` and `step` return a dict, and its receivers see one. In between the parts lie side by side in one
tensor, so that executors, messages and records know nothing of them. Its type holds the values of all parts exactly.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from math import prod
from typing import Any

import numpy as np
import torch
from torch import Tensor

Declared = Mapping[str, tuple[tuple[int, ...], torch.dtype]]
"""By name, shape of one environment's tensor and its type."""

_EXACT = {  # bits of the whole numbers that a floating-point type holds exactly
    torch.float16: 11,
    torch.bfloat16: 8,
    torch.float32: 24,
    torch.float64: 53,
}


class PartsError(ValueError):
    """Declared parts cannot be put together, or an output does not have them."""


@dataclass(frozen=True)
class Parts:
    """The parts of an output.

    Attributes:
        entries: name, shape and type of each, in their order.
        dtype: of the tensor that holds them all.
    """

    entries: tuple[tuple[str, tuple[int, ...], torch.dtype], ...]
    dtype: torch.dtype

    @classmethod
    def of(cls, declared: Declared) -> "Parts":
        """Lay out declared parts.

        Raises:
            PartsError: there are none, one is no shape and type, or no type holds all of them.
        """
        entries = []
        for name, own in declared.items():
            try:
                shape, dtype = own
                entry = (str(name), tuple(int(size) for size in shape), dtype)
            except (TypeError, ValueError):
                entry = (str(name), (-1,), None)
            if min(entry[1], default=0) < 0 or not isinstance(entry[2], torch.dtype):
                raise PartsError(f'"{name}": {own!r} is no shape and type; give ((2,), torch.float64), say')
            entries.append(entry)
        if not entries:
            raise PartsError("there are no parts; leave outputs out for a single tensor")
        return cls(tuple(entries), _common({name: dtype for name, _, dtype in entries}))

    def pack(self, output: Any) -> Tensor:
        """The parts (B, ...) side by side, (B, size).

        Raises:
            PartsError: they are not those that are declared.
        """
        names = [name for name, _, _ in self.entries]
        if not isinstance(output, Mapping) or set(output) != set(names):
            there = sorted(output) if isinstance(output, Mapping) else type(output).__name__
            raise PartsError(f"the output is {there}, declared are the parts {names}")
        flat = []
        for name, shape, dtype in self.entries:
            value = output[name]
            if (
                not isinstance(value, Tensor)
                or value.ndim == 0
                or value.shape[1:] != shape
                or value.dtype != dtype
            ):
                found = (
                    f"{value.dtype} {tuple(value.shape)}"
                    if isinstance(value, Tensor)
                    else type(value).__name__
                )
                raise PartsError(
                    f'part "{name}" is {found}, declared {dtype} (B, {", ".join(map(str, shape))})'
                )
            flat.append(value.reshape(len(value), prod(shape)).to(self.dtype))
        return torch.cat(flat, 1)

    def split(self, packed: Tensor) -> dict[str, Tensor]:
        """The parts (..., *shape) of tensors (..., size)."""
        result, first = {}, 0
        for name, shape, dtype in self.entries:
            last = first + prod(shape)
            result[name] = packed[..., first:last].reshape(*packed.shape[:-1], *shape).to(dtype)
            first = last
        return result

    def split_array(self, packed: np.ndarray) -> dict[str, np.ndarray]:
        """The parts (..., *shape) of arrays (..., size), as an episode has them."""
        parts = self.split(torch.from_numpy(np.array(packed)))
        return {name: value.numpy() for name, value in parts.items()}


def _common(types: Mapping[str, torch.dtype]) -> torch.dtype:
    """The smallest type that holds the values of all exactly."""
    floats = {name: dtype for name, dtype in types.items() if dtype.is_floating_point}
    whole = {name: dtype for name, dtype in types.items() if name not in floats}
    if complex_ := [name for name, dtype in types.items() if dtype.is_complex]:
        raise PartsError(f'"{complex_[0]}" is of complex numbers; put out their real and imaginary parts')
    if not floats:
        return reduce(torch.promote_types, whole.values())
    bits = max((1 if d == torch.bool else torch.iinfo(d).bits for d in whole.values()), default=0)
    dtype = reduce(torch.promote_types, floats.values())
    for wider in (dtype, torch.float32, torch.float64):
        if _EXACT[wider] >= max(bits, _EXACT[dtype]):
            return wider
    largest = next(name for name, d in whole.items() if d != torch.bool and torch.iinfo(d).bits == bits)
    raise PartsError(
        f'"{largest}" {whole[largest]} beside "{next(iter(floats))}" {floats[next(iter(floats))]}: no type holds both '
        "exactly; put out numbers of at most 32 bits"
    )

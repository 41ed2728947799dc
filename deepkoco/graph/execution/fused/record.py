"""Records: how the numbers of a block of environments lie in memory.

A record holds fields; of each element of a field the lanes (environments) lie side by side. Fields with
large numbers come first, so that everything is aligned to its own size.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

NUMPY = {
    torch.float32: np.float32,
    torch.float64: np.float64,
    torch.int64: np.int64,
    torch.int32: np.int32,
    torch.bool: np.bool_,
}
Key = TypeVar("Key")
Spec = tuple[torch.dtype, tuple[int, ...]]
"""Type of a tensor and its shape without the batch."""


@dataclass(frozen=True)
class Field:
    """One tensor of a record.

    Attributes:
        dtype, shape: of one environment.
        offset: from the start of the record [bytes per lane].
    """

    dtype: torch.dtype
    shape: tuple[int, ...]
    offset: int

    @property
    def count(self) -> int:
        return math.prod(self.shape)

    @property
    def size(self) -> int:
        """Bytes of one element."""
        return self.dtype.itemsize


NUMBER = Field(torch.int32, (), 0)
"""What a record begins with: the step in the moving one, the environment in the fixed one."""


def lay_out(specs: Mapping[Key, Spec], start: int = 0) -> tuple[dict[Key, Field], int]:
    """Place tensors one after the other, those of large numbers first; return the fields and the end."""
    fields, offset = {}, start
    for name, (dtype, shape) in sorted(specs.items(), key=lambda item: -item[1][0].itemsize):
        fields[name] = Field(dtype, shape, offset)
        offset += fields[name].count * dtype.itemsize
    return {name: fields[name] for name in specs}, -(-offset // 8) * 8


class Records:
    """The records of all blocks, (blocks, bytes) in one buffer.

    Args:
        buffer: (blocks, bytes per record) uint8.
        lanes: environments of a block.
    """

    def __init__(self, buffer: np.ndarray, lanes: int) -> None:
        self.buffer, self.lanes = buffer, lanes

    def view(self, field: Field, copies: int = 1) -> np.ndarray:
        """The numbers of a field, (blocks, copies * elements, lanes), to read or write."""
        first = field.offset * self.lanes
        count = copies * field.count
        part = self.buffer[:, first : first + count * field.size * self.lanes]
        return part.view(NUMPY[field.dtype]).reshape(len(self.buffer), count, self.lanes)

    def pack(self, field: Field, values: Tensor, source: np.ndarray) -> None:
        """Write (B, ...) values, or one for all; lane l of the whole buffer takes environment source[l]."""
        rows = values.detach().to("cpu", field.dtype).numpy()
        view = self.view(field)
        if rows.ndim == 0:
            view[...] = rows
            return
        rows = rows.reshape(len(rows), field.count)
        rows = np.broadcast_to(rows, (len(source), field.count)) if len(rows) == 1 else rows[source]
        view[...] = rows.reshape(len(self.buffer), self.lanes, field.count).transpose(0, 2, 1)

    def unpack(self, field: Field, lane_of: np.ndarray, cell: int = 0) -> Tensor:
        """Read (B, ...) values; environment b is lane lane_of[b]; `cell` counts repetitions of the field."""
        first = (field.offset + cell * field.count * field.size) * self.lanes
        part = self.buffer[:, first : first + field.count * field.size * self.lanes]
        view = part.view(NUMPY[field.dtype]).reshape(len(self.buffer), field.count, self.lanes)
        rows = view.transpose(0, 2, 1).reshape(len(self.buffer) * self.lanes, field.count)
        rows = rows[lane_of] if len(rows) > 1 else rows.copy()
        return torch.from_numpy(rows.reshape(len(rows), *field.shape))

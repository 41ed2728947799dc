"""Memory whose address is known without asking numpy, which takes longer than a step of one environment."""

import ctypes
from typing import Any

import numpy as np
from torch import Tensor

_SMALL = 1 << 15  # bytes that ctypes clears faster than numpy makes an array


class Memory:
    """Bytes for a kernel.

    Args:
        size: number of bytes.
        kept: an array to take over in place of new bytes.

    Attributes:
        address: where they begin.
    """

    __slots__ = ("_array", "_bytes", "address")

    def __init__(self, size: int, kept: np.ndarray | None = None) -> None:
        self._bytes, self._array = None, None
        if kept is None and size <= _SMALL:
            self._bytes = (ctypes.c_char * size)()
            self.address = ctypes.addressof(self._bytes)
        else:
            self._array = np.empty(size, dtype=np.uint8) if kept is None else np.ascontiguousarray(kept)
            self.address = self._array.ctypes.data

    def view(self, dtype: type | np.dtype, count: int = -1, offset: int = 0) -> np.ndarray:
        """Numbers (count,) from an offset [bytes]."""
        own: Any = self._bytes if self._array is None else self._array
        return np.frombuffer(own, dtype, count, offset)

    def rows(self, count: int) -> np.ndarray:
        """All bytes as (count, ...) uint8."""
        return self.view(np.uint8).reshape(count, -1)


def address(array: np.ndarray | Tensor) -> int:
    """Where the numbers of an array begin."""
    if isinstance(array, Tensor):
        return array.data_ptr()
    if array.flags.writeable and array.size:
        own: Any = array
        return ctypes.addressof(ctypes.c_char.from_buffer(own))
    return array.ctypes.data

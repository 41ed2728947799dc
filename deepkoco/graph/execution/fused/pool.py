"""Pools: the large constants of a kernel in one piece of memory."""

from dataclasses import dataclass, field

import numpy as np
from torch import Tensor


@dataclass
class Pool:
    """Large constants, one after the other."""

    parts: list[np.ndarray] = field(default_factory=list)
    size: int = 0

    def add(self, tensor: Tensor) -> int:
        """Append a tensor and return where it starts [bytes]."""
        numbers = tensor.numpy()
        part = numbers.astype(np.uint8) if numbers.dtype == np.bool_ else numbers
        data = np.frombuffer(part.tobytes(), dtype=np.uint8)
        start = self.size
        self.parts.append(np.concatenate([data, np.zeros(-len(data) % 64, dtype=np.uint8)]))
        self.size += len(self.parts[-1])
        return start

    def join(self) -> np.ndarray:
        return np.concatenate([np.zeros(0, dtype=np.uint8), *self.parts])

"""Unknown zeros of sensors, one set per log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import System


@dataclass(frozen=True)
class EncoderZeros:
    """One unknown zero for each log and each channel with an unknown zero: of an encoder, a gyro, a draw wire.

    A vector of zeros contains those of the first such channel, one per log, then those of the next channel.

    Attributes:
        channels: Indices of the channels.
        sd: Standard deviation of each channel's zeros around 0, in its unit.
        logs: Number of logs.
    """

    channels: tuple[int, ...]
    sd: tuple[float, ...]
    logs: int

    @staticmethod
    def of(system: System, logs: int, sd: float | None = None) -> EncoderZeros:
        """Zeros that a system declares; ``sd`` [rad] replaces those of angles, and 0 means known zeros of them."""
        spread = [sd if sd is not None and c.angle else c.zero_sd for c in system.measurements]
        channels = tuple(c for c, s in enumerate(spread) if s > 0.0)
        return EncoderZeros(channels, tuple(spread[c] for c in channels), logs)

    @property
    def count(self) -> int:
        """Length of a vector of zeros."""
        return len(self.channels) * self.logs

    @property
    def spread(self) -> np.ndarray:
        """(count,) prior standard deviations, in the units of the channels."""
        return np.repeat(np.array(self.sd), self.logs)

    @property
    def precision(self) -> Tensor:
        """(count,) prior precisions."""
        return torch.from_numpy(1.0 / self.spread**2)

    def none(self) -> Tensor:
        """A vector (count,) of zeros that are all 0."""
        return torch.zeros(self.count, dtype=torch.float64)

    def add(self, predicted: Tensor, zero: Tensor, log: np.ndarray) -> None:
        """Add zeros (L, count) to predicted measurements (L, W, N, M) of windows from the logs (W,), in place."""
        for k, channel in enumerate(self.channels):
            predicted[:, :, channel] += zero[:, k * self.logs + log][..., None]

    def slopes(self, weight: Tensor, log: np.ndarray) -> Tensor:
        """(count, W, N, M) derivatives of the measurements by the zeros, times the weights (W, N, M)."""
        result = torch.zeros(self.count, *weight.shape, dtype=torch.float64)
        of_log = torch.from_numpy(log[None] == np.arange(self.logs)[:, None])
        for k, channel in enumerate(self.channels):
            part = result[k * self.logs : (k + 1) * self.logs]
            part[:, :, channel] = weight[:, channel] * of_log[..., None]
        return result

    def unit(self, index: int, system: System) -> str:
        """Unit of one element of a vector of zeros."""
        return system.measurements[self.channels[index // self.logs]].unit

    def name(self, index: int, system: System) -> str:
        """Name of one element of a vector of zeros, for reports."""
        k, log = divmod(index, self.logs)
        of = f" of {system.measurements[self.channels[k]].name}" if len(self.channels) > 1 else ""
        return f"zero{of} of log {log + 1}"

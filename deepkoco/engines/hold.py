"""What a zero-order hold delivers over a tick when commands arrive within it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import Input


def mean_over_tick(values: Tensor, commands: Input, period: float) -> Tensor:
    """Time average (B, ...) over the tick that ends now.

    Args:
        values: (B, window, ...) what each of the commands delivers.
        commands: The commands, with their arrivals.
        period: Length of the tick [s].
    """
    end = commands.t_start
    return held_integral(values, commands.t_received, end - period, end) / period


def held_integral(values: Tensor, acts: Tensor, begin: Tensor, end: Tensor) -> Tensor:
    """Integral (B, ...) over time of what is held.

    Each value holds from the time at which it acts to that of the next one; the oldest has held since ever.

    Args:
        values: (B, window, ...), oldest first.
        acts: (B, window) times from which they act [s].
        begin, end: (B,) [s].
    """
    begin, end = begin[:, None], end[:, None]
    arrival = torch.minimum(torch.maximum(acts, begin), end)
    until = torch.cat([arrival[:, 1:], end], 1)
    since = torch.cat([begin, arrival[:, 1:]], 1)
    held = until - since
    if values.ndim > 2:
        held = held.unsqueeze(-1)
    return (values * held).sum(1)


def means_within_tick(values: Tensor, commands: Input, period: float, parts: int) -> np.ndarray:
    """Time averages (B, parts, M) over equal parts of the tick that ends now.

    Each command holds from its arrival to the next one's; the oldest has held since before the tick.

    Args:
        values: (B, window, M) what each of the commands delivers.
        commands: The commands, with their arrivals.
        period: Length of the tick [s].
        parts: Number of parts.
    """
    begin = commands.t_start.numpy() - period
    arrival = (
        commands.t_received.numpy()[:, 1:] - begin[:, None]
    )  # of all but the oldest, since the begin [s]
    if arrival.shape[1] == 0 or arrival.max() <= 0.0:
        return values[:, -1:].expand(-1, parts, -1).numpy()
    length = period / parts
    ends = length * np.arange(1, parts + 1)
    # Share of each part in which a command has arrived: it replaces the one before it for that long.
    share = np.clip((ends[:, None] - arrival[:, None]) / length, 0.0, 1.0)  # (B, parts, window - 1)
    held = values.numpy()
    means = np.repeat(held[:, :1], parts, axis=1)
    for k in range(arrival.shape[1]):
        means += share[:, :, k, None] * (held[:, None, k + 1] - held[:, None, k])
    return means

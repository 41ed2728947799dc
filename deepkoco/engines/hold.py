"""What a zero-order hold delivers over a tick when commands arrive within it."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.graph import Input


def mean_over_tick(values: Tensor, commands: Input, period: float) -> Tensor:
    """Time average (B, ...) over the tick that ends now.

    Each command holds from its arrival to the next one's; the oldest has held since before the tick.

    Args:
        values: (B, window, ...) what each of the commands delivers.
        commands: The commands, with their arrivals.
        period: Length of the tick [s].
    """
    end = commands.t_start
    arrival = torch.minimum(torch.maximum(commands.t_received, (end - period)[:, None]), end[:, None])
    until = torch.cat([arrival[:, 1:], end[:, None]], 1)
    since = torch.cat([(end - period)[:, None], arrival[:, 1:]], 1)
    held = until - since
    if values.ndim > 2:
        held = held.unsqueeze(-1)
    return (values * held).sum(1) / period

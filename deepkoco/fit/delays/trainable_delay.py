"""A hidden delay inside a node: what arrived at an instant that a parameter moves.

A node with an input of several messages reads it ``delay = low + alpha (high - low)`` seconds late, where alpha in
[0, 1] is a parameter like any other: it is fitted with the dynamics, runs in every executor and differs from
environment to environment. The connection's window must reach back further than ``high``.

Source: thesis sec. 4.3.3.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.graph.model.node import Input


def held(seen: Input, alpha: Tensor, low: float, high: float) -> Tensor:
    """Newest message that had arrived ``delay`` ago (zero-order hold): how commands act.

    Args:
        seen: (B, window, ...) messages.
        alpha: Scalar or (B,), in [0, 1].
        low: Delay at alpha = 0 [s].
        high: Delay at alpha = 1 [s].

    Returns:
        (B, ...); the oldest message where none is old enough. Piecewise constant in alpha: search it by populations.
    """
    at = seen.t_start - (low + alpha * (high - low))
    share = (at[:, None] >= seen.t_received[:, 1:]).to(seen.data.dtype)
    return _taken(seen.data, share)


def interpolated(seen: Input, alpha: Tensor, low: float, high: float) -> Tensor:
    """As :func:`held`, linear between messages: how a smooth signal is seen late; differentiable in alpha."""
    at = seen.t_start - (low + alpha * (high - low))
    before, after = seen.t_received[:, :-1], seen.t_received[:, 1:]
    known = torch.isfinite(before)
    gap = torch.where(known, after - torch.where(known, before, 0.0), 1.0).clamp_min(1e-9)
    begin = torch.where(known, before, after)
    # An initial output has always been there: it holds until the first message arrives.
    share = torch.where(known, (at[:, None] - begin) / gap, (at[:, None] >= after).to(gap.dtype))
    return _taken(seen.data, share.clamp(0.0, 1.0).to(seen.data.dtype))


def _taken(data: Tensor, share: Tensor) -> Tensor:
    """First message plus each difference to the next as far as its share, (B, window - 1), says."""
    share = share.reshape(*share.shape, *(1,) * (data.ndim - 2))
    return data[:, 0] + (share * (data[:, 1:] - data[:, :-1])).sum(1)

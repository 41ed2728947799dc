"""A trainable delay inside a node, which is a parameter of that node.

A node with an input of several messages reads it ``delay = low + alpha (high - low)`` [s] late. The parameter alpha in
[0, 1] is fitted together with the dynamics. It runs in every executor and can differ from environment to environment.
The window of the connection must reach back further than ``high``.

Source: thesis sec. 4.3.3.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.graph.model.node import Input


def held(seen: Input, alpha: Tensor, low: float, high: float) -> Tensor:
    """Newest message that had arrived ``delay`` ago (zero-order hold), as commands act.

    Args:
        seen: (B, window, ...) messages.
        alpha: Scalar or (B,), in [0, 1].
        low: Delay at alpha = 0 [s].
        high: Delay at alpha = 1 [s].

    Returns:
        (B, ...); the oldest message where none is old enough. Piecewise constant in alpha, so fit alpha by CMA-ES.
    """
    at = seen.t_start - (low + alpha * (high - low))
    share = (at[:, None] >= seen.t_received[:, 1:]).to(seen.data.dtype)
    return _blended(seen.data, share)


def interpolated(seen: Input, alpha: Tensor, low: float, high: float) -> Tensor:
    """As :func:`held`, but linear between messages and differentiable in alpha; for smooth signals."""
    at = seen.t_start - (low + alpha * (high - low))
    before, after = seen.t_received[:, :-1], seen.t_received[:, 1:]
    known = torch.isfinite(before)
    gap = torch.where(known, after - torch.where(known, before, 0.0), 1.0).clamp_min(1e-9)
    begin = torch.where(known, before, after)
    # An initial output has no time of arrival: it holds until the first message arrives.
    share = torch.where(known, (at[:, None] - begin) / gap, (at[:, None] >= after).to(gap.dtype))
    return _blended(seen.data, share.clamp(0.0, 1.0).to(seen.data.dtype))


def _blended(data: Tensor, share: Tensor) -> Tensor:
    """First message plus the differences of successive messages, weighted by ``share`` (B, window - 1)."""
    share = share.reshape(*share.shape, *(1,) * (data.ndim - 2))
    return data[:, 0] + (share * (data[:, 1:] - data[:, :-1])).sum(1)

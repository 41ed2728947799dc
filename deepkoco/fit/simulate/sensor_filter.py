"""First-order filter of sensors: exact for the cubic states between integration nodes."""

from __future__ import annotations

import numpy as np
import torch
from numba import njit
from torch import Tensor

from deepkoco.fit.simulate.nodes import Nodes


def filtered(nodes: Nodes, time_constant: Tensor, h: float) -> Nodes:
    """Filter simulated states by T y' + y = x.

    Within a step x is a cubic, so y = p + (y_0 - p_0) exp(-t/T) with p = x - T x' + T^2 x'' - T^3 x'''. A window starts
    with y = p, as if its first cubic had lasted for a long time.

    Args:
        nodes: Simulated states.
        time_constant: T [s], scalar or (L,); lanes with 0 are not filtered.
        h: Integration step [s].
    """
    lanes = nodes.value[0].shape[-1]
    slow = time_constant.expand(lanes)
    own = torch.nonzero(slow > 0.0).flatten()
    constant = slow[own]
    decay = torch.exp(-h / constant)
    shown, lefts, rights = [], [], []
    for value, left, right in zip(*nodes, strict=True):
        x, d0, d1 = value[..., own], left[..., own] * h, right[..., own] * h
        rise = x[1:] - x[:-1]
        second = 2.0 * (3.0 * rise - 2.0 * d0 - d1)  # x'' h^2 at the start
        third = 6.0 * (d0 + d1 - 2.0 * rise)  # x''' h^3
        k = constant / h
        tail = k**3 * third
        first = x[:-1] - k * d0 + k**2 * second - tail
        last = x[1:] - k * d1 + k**2 * (second + third) - tail
        flat = first.flatten(1).contiguous().numpy(), last.flatten(1).contiguous().numpy()
        each = decay.expand(first.shape[1:]).flatten().contiguous().numpy()
        y = torch.from_numpy(_along(*flat, each)).reshape(x.shape)
        seen, slope_0, slope_1 = value.clone(), left.clone(), right.clone()
        seen[..., own] = y
        slope_0[..., own] = (x[:-1] - y[:-1]) / constant
        slope_1[..., own] = (x[1:] - y[1:]) / constant
        shown.append(seen)
        lefts.append(slope_0)
        rights.append(slope_1)
    return type(nodes)(tuple(shown), tuple(lefts), tuple(rights))


@njit(cache=True, nogil=True)
def _along(first: np.ndarray, last: np.ndarray, decay: np.ndarray) -> np.ndarray:
    """Values (S + 1, M) at the nodes, from p (S, M) at the start and the end of each step and its decay (M,)."""
    y = np.empty((len(first) + 1, first.shape[1]))
    y[0] = first[0]
    for i in range(len(first)):
        for m in range(first.shape[1]):
            y[i + 1, m] = last[i, m] + (y[i, m] - first[i, m]) * decay[m]
    return y

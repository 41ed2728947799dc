"""Triangular matrices of a batch of environments, in operations that every executor of a graph can compile.

LAPACK takes one small matrix after the other and cannot be traced. These loops run over the columns of one matrix and
treat all environments at once.
"""

from __future__ import annotations

import torch
from torch import Tensor


def lower_root(rows: Tensor) -> Tensor:
    """Lower triangular L with L L^T = rows^T rows, its diagonal not negative.

    Modified Gram-Schmidt: its triangular factor is as exact as that of Householder's reflections.

    Args:
        rows: (B, m, n); of any rank.

    Returns:
        (B, n, n).

    Source: Bjoerck, Numerics of Gram-Schmidt orthogonalization (1994).
    """
    size, columns = rows.shape[-1], []
    for j in range(size):
        length = (rows[..., 0] * rows[..., 0]).sum(-1, keepdim=True).sqrt()  # (B, 1)
        parts = [torch.zeros_like(rows[:, :j, 0])] if j else []
        parts.append(length)
        if j + 1 < size:
            unit = (rows[..., 0] / torch.where(length > 0, length, 1.0))[..., None]
            rest = rows[..., 1:]
            share = (unit * rest).sum(1)
            parts.append(share)
            rows = rest - unit * share[:, None]
        columns.append(torch.cat(parts, 1))
    return torch.stack(columns, -1)


def solve_lower(root: Tensor, right: Tensor) -> Tensor:
    """The solution (B, n) of L y = b by substitution.

    Args:
        root: L (B, n, n), its diagonal positive.
        right: b (B, n).
    """
    found: list[Tensor] = []
    for i in range(root.shape[-1]):
        left = right[:, i]
        for j, value in enumerate(found):
            left = left - root[:, i, j] * value
        found.append(left / root[:, i, i])
    return torch.stack(found, -1)

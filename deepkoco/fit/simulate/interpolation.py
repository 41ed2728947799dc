"""States between the nodes of integration steps: cubics with the values and derivatives at both ends of a step."""

from __future__ import annotations

import torch
from numba import njit
from torch import Tensor

from deepkoco.fit.simulate.nodes import Nodes
from deepkoco.systems.plain import is_plain

LINE = 8  # numbers in a line of the processor's cache: so many lanes are written together


def states_at(nodes: Nodes, t: Tensor, h: float) -> Tensor:
    """Interpolate states by Hermite cubics.

    Args:
        nodes: Simulated states and their derivatives.
        t: (W, M) times after the start of each window [s], or (W, M, L) with other times for each lane.
        h: Integration step [s].

    Returns:
        States (W, M, L, S). Plain numbers lie in memory in the order (L, W, S, M), in which problems are solved.
    """
    steps, count, lanes = nodes.left[0].shape
    cell = (t / h).floor().long().clamp(0, steps - 1)
    weights = _hermite(t / h - cell, h)
    parts = [*nodes.value, *nodes.left, *nodes.right]
    if not is_plain([t, *parts]):
        return _by_torch(nodes, cell, weights)
    result = torch.empty(lanes, count, len(nodes.value), t.shape[1], dtype=torch.float64)
    write = _write if t.ndim == 2 else _write_each
    at, given = cell.numpy(), torch.stack(weights).numpy()
    for s, (value, left, right) in enumerate(zip(*nodes, strict=True)):
        x, first, last = (part.contiguous().numpy() for part in (value, left, right))
        write(x, first, last, at, given, s, result.numpy())
    return result.permute(1, 3, 0, 2)


def _hermite(s: Tensor, h: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Weights of the value and slope at the start and of the value and slope at the end of a step."""
    r = 1.0 - s
    return r * r * (1.0 + 2.0 * s), h * s * r * r, s * s * (3.0 - 2.0 * s), -h * s * s * r


@njit(cache=True, error_model="numpy", nogil=True)
def _write(value, left, right, cell, weights, state, result):
    """Write one state at the same times for all lanes.

    Args:
        value: (n + 1, W, L) states at the nodes.
        left, right: (n, W, L) derivatives at both ends of each step.
        cell: (W, M) steps in which the times are.
        weights: (4, W, M) weights of both values and derivatives.
        state: Number of the state.
        result: (L, W, S, M), changed.
    """
    lanes, windows, _, samples = result.shape
    for first in range(0, lanes, LINE):
        last = min(first + LINE, lanes)
        for w in range(windows):
            for m in range(samples):
                at = cell[w, m]
                w0, w1, w2, w3 = weights[0, w, m], weights[1, w, m], weights[2, w, m], weights[3, w, m]
                for lane in range(first, last):
                    total = w0 * value[at, w, lane] + w1 * left[at, w, lane]
                    total = total + w2 * value[at + 1, w, lane] + w3 * right[at, w, lane]
                    result[lane, w, state, m] = total


@njit(cache=True, error_model="numpy", nogil=True)
def _write_each(value, left, right, cell, weights, state, result):
    """As :func:`_write`, with other times for each lane: ``cell`` (W, M, L), ``weights`` (4, W, M, L)."""
    lanes, windows, _, samples = result.shape
    for w in range(windows):
        for m in range(samples):
            for lane in range(lanes):
                at = cell[w, m, lane]
                total = weights[0, w, m, lane] * value[at, w, lane]
                total += weights[1, w, m, lane] * left[at, w, lane]
                total += weights[2, w, m, lane] * value[at + 1, w, lane]
                total += weights[3, w, m, lane] * right[at, w, lane]
                result[lane, w, state, m] = total


def _by_torch(nodes: Nodes, cell: Tensor, weights: tuple[Tensor, Tensor, Tensor, Tensor]) -> Tensor:
    """As :func:`_write` for all states, with gradients."""
    lanes = nodes.left[0].shape[2]
    window, lane = torch.arange(cell.shape[0])[:, None, None], torch.arange(lanes)
    each = cell.ndim == 3
    cell = cell if each else cell[..., None]
    w0, w1, w2, w3 = (w if each else w[..., None] for w in weights)
    parts = []
    for value, left, right in zip(*nodes, strict=True):
        before, after = value[cell, window, lane], value[cell + 1, window, lane]
        parts.append(
            w0 * before + w1 * left[cell, window, lane] + w2 * after + w3 * right[cell, window, lane]
        )
    return torch.stack(parts, -1)

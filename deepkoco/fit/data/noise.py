"""Sensor noise estimated from a measured series itself."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.logs.quantum import quantum_of

ORDERS = range(2, 9)  # polynomial degrees that the differences remove


class Noise(NamedTuple):
    """Standard deviation of a channel's noise, in the channel's unit, and its relative uncertainty."""

    sd: float
    relative_sd: float


def estimate_noise(t: np.ndarray, value: np.ndarray, fallback: float) -> Noise:
    """Standard deviation of what no smooth curve through neighbouring samples explains.

    A normalised divided difference of order d annihilates polynomials up to degree d - 1 on any time
    stamps and leaves white noise at its size. The motion leaks less the higher the order, until the
    order suits the motion: the smallest estimate over the orders is taken. A rounded series has at
    least the noise of its quantum q, q / sqrt(12).

    Args:
        t: (n,) time stamps [s], increasing.
        value: (n,) samples.
        fallback: Standard deviation that holds where the series is too short to tell.

    Returns:
        The estimate.
    """
    if len(t) < 40:
        return Noise(fallback, 0.3)
    quantum = quantum_of(value)
    best = math.inf
    for order in ORDERS:
        difference = _normalised_difference(t, value, order)
        best = min(best, _clipped_sd(difference))
    sd = max(best, quantum / math.sqrt(12.0), 1e-12)
    # Neighbouring differences share samples; about one in three is independent of the others.
    return Noise(sd, math.sqrt(3.0 / (2.0 * len(t))))


def residual_noise(
    t: np.ndarray, residual: np.ndarray, valid: np.ndarray, quantum: float, before: Noise
) -> Noise:
    """Noise from what a fitted model leaves, by the same differences within each window.

    The motion itself leaks into the differences of a fast motion sampled slowly; what a model leaves of
    the motion is far smaller, so its differences show the noise better. The estimate only ever falls.

    Args:
        t: (W, M) time stamps [s].
        residual: (W, M) measured minus simulated.
        valid: (W, M) True where there is a sample; valid samples come first in each row.
        quantum: Step to which the sensor rounds, 0 if it does not.
        before: Estimate from the measurements.
    """
    best = before.sd
    for order in (2, 3, 4):
        parts = []
        for row in range(len(t)):
            n = int(valid[row].sum())
            if n > order + 1:
                parts.append(_normalised_difference(t[row, :n], residual[row, :n], order))
        if parts and sum(map(len, parts)) >= 40:
            best = min(best, _clipped_sd(np.concatenate(parts)))
    return Noise(max(best, quantum / math.sqrt(12.0), 1e-12), before.relative_sd)


def _normalised_difference(t: np.ndarray, value: np.ndarray, order: int) -> np.ndarray:
    rows = np.arange(len(t) - order)[:, None] + np.arange(order + 1)
    stamps = t[rows]
    gap = stamps[:, :, None] - stamps[:, None, :]
    gap /= np.abs(gap).max(axis=(1, 2), keepdims=True)
    gap[:, np.arange(order + 1), np.arange(order + 1)] = 1.0
    weight = 1.0 / gap.prod(axis=2)
    weight /= np.linalg.norm(weight, axis=1, keepdims=True)
    return (weight * value[rows]).sum(axis=1)


def _clipped_sd(difference: np.ndarray) -> float:
    """Root mean square after clipping at 3 standard deviations, corrected for what the clipping takes."""
    scale = 1.4826 * float(np.median(np.abs(difference)))
    if scale == 0.0:
        return float(np.sqrt(np.mean(difference**2)))
    for _ in range(5):
        inside = difference[np.abs(difference) < 3.0 * scale]
        # Variance of a standard normal truncated at 3 is 0.9733.
        scale = float(np.sqrt(np.mean(inside**2) / 0.9733))
    return scale

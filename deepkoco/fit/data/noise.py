"""Estimate the sensor noise of a measured series by differences."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.logs.quantum import quantum_of

ORDERS = range(2, 9)  # polynomial degrees that the differences remove


class Noise(NamedTuple):
    """Standard deviation of a channel's noise in the channel's unit, and relative standard error of it."""

    sd: float
    relative_sd: float


def estimate_noise(t: np.ndarray, value: np.ndarray, fallback: float) -> Noise:
    """Estimate the standard deviation of the noise by normalised divided differences.

    A difference of order d removes polynomials up to degree d - 1 on any time stamps. It does not change the standard
    deviation of white noise. The share of the motion in the differences depends on the order, so the smallest
    estimate over the orders is used. The noise of a series rounded to a quantum q is at least q / sqrt(12).

    Args:
        t: (n,) time stamps [s], increasing.
        value: (n,) samples.
        fallback: Standard deviation for a series of less than 40 samples, in the unit of the values.

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
    # Neighbouring differences share samples: about one third of them is independent.
    return Noise(sd, math.sqrt(3.0 / (2.0 * len(t))))


def residual_noise(
    t: np.ndarray, residual: np.ndarray, valid: np.ndarray, quantum: float, before: Noise
) -> Noise:
    """Estimate the noise from the residuals of a fit, by the same differences within each window.

    Differences of a fast motion with a low sample rate contain a part of the motion. Residuals contain much less of it,
    so they give a better estimate. The result is never larger than ``before``.

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
    """Root mean square without values beyond 3 standard deviations, corrected for their variance."""
    scale = 1.4826 * float(np.median(np.abs(difference)))
    if scale == 0.0:
        return float(np.sqrt(np.mean(difference**2)))
    for _ in range(5):
        inside = difference[np.abs(difference) < 3.0 * scale]
        # Variance of a standard normal truncated at 3 is 0.9733.
        scale = float(np.sqrt(np.mean(inside**2) / 0.9733))
    return scale

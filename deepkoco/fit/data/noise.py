"""Estimate the sensor noise of a measured series by differences."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.logs.quantum import quantum_of

ORDERS = range(2, 9)  # polynomial degrees that the differences remove
STAMP_ORDER = (
    2  # of the differences that show jitter: higher ones mix rates of samples that are farther apart
)
CLIP = 9.0  # squared sum of a difference in its standard deviations at which it counts as an outlier


class Noise(NamedTuple):
    """Noise of a channel, in the channel's unit.

    Attributes:
        sd: Standard deviation.
        relative_sd: Relative standard error of it.
        simulated_sd: The part of ``sd`` that is no noise of the sensor: what a simulation cannot follow, because its
            commands were rounded or its steps are finite.
    """

    sd: float
    relative_sd: float
    simulated_sd: float = 0.0

    @property
    def sensor_sd(self) -> float:
        """Standard deviation of the noise of the sensor alone."""
        return math.sqrt(max(self.sd**2 - self.simulated_sd**2, 0.0))

    def times(self, factor: float) -> Noise:
        """Noise that is larger by a factor in all its parts."""
        return self._replace(sd=factor * self.sd, simulated_sd=factor * self.simulated_sd)

    def with_simulated(self, variance: float) -> Noise:
        """Add a variance that is no noise of the sensor."""
        sd = math.sqrt(self.sd**2 + variance)
        return self._replace(sd=sd, simulated_sd=math.sqrt(self.simulated_sd**2 + variance))


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


def stamp_jitter(
    t: np.ndarray,
    value: np.ndarray,
    residual: np.ndarray,
    valid: np.ndarray,
    least: np.ndarray,
    evidence: float,
    largest: float,
) -> tuple[float, np.ndarray]:
    """Estimate how far time stamps scatter, from residuals that are larger where the channels change faster.

    A stamp that is wrong by dt changes a sample by the channel's rate times dt. Differences of neighbouring residuals
    contain the noise r^2 and the jitter (rate sigma_t)^2, but little of a model error, which is smooth. The likelihood
    of one sigma_t for all channels is compared with that of 0.

    Args:
        t: (W, N, M) time stamps [s].
        value: (W, N, M) measurements.
        residual: (W, N, M) measured minus simulated, in the channels' units.
        valid: (W, N, M) True where there is a sample; valid samples come first.
        least: (N,) least r of each channel: a rounded channel at rest repeats its value, which is no lack of noise.
        evidence: Twice the log likelihood ratio from which jitter is believed.
        largest: Largest sigma_t [s].

    Returns:
        sigma_t [s], 0 without evidence, and (N,) standard deviation r of each channel, NaN where it has few samples.
    """
    rate, pieces = rates(t, value, valid), {}
    for c in range(value.shape[1]):
        parts = []
        for w in range(len(value)):
            n = int(valid[w, c].sum())
            if n > STAMP_ORDER + 1:
                weight, rows = difference_weights(t[w, c, :n], STAMP_ORDER)
                moved = (weight * residual[w, c, :n][rows]).sum(1)
                parts.append((moved, ((weight * rate[w, c, :n][rows]) ** 2).sum(1)))
        if parts and sum(len(moved) for moved, _ in parts) >= 40:
            moved, fast = (np.concatenate(x) for x in zip(*parts, strict=True))
            pieces[c] = (moved**2, fast)
    sd = np.full(value.shape[1], np.nan)
    typical = max(
        (
            float(np.sqrt(fast.mean() / max(np.median(square), 1e-2 * square.mean(), 1e-300)))
            for square, fast in pieces.values()
        ),
        default=0.0,
    )
    if not typical > 0.0:
        return 0.0, sd
    grid = np.append(0.0, np.geomspace(0.03, 30.0, 25) / typical)
    grid = grid[grid <= largest]
    cost, noise = _costs(pieces, grid, least)
    found = int(cost.argmin())
    # Neighbouring differences share samples: about one third of them is independent.
    if (cost[0] - cost[found]) / (STAMP_ORDER + 1) < evidence:
        found = 0
    if found:
        # Once more between the neighbours: the first grid is a third apart.
        ends = grid[max(found - 1, 1)], grid[min(found + 1, len(grid) - 1)]
        grid = np.append(grid[found], np.geomspace(*ends, 13))
        cost, noise = _costs(pieces, grid, least)
        found = int(cost.argmin())
    for c in pieces:
        sd[c] = noise[c][found]
    return float(grid[found]), sd


def _costs(
    pieces: dict[int, tuple[np.ndarray, np.ndarray]], grid: np.ndarray, least: np.ndarray
) -> tuple[np.ndarray, dict[int, list[float]]]:
    """Cost of all channels at each sigma_t of a grid, and each channel's best r there."""
    best = {
        c: [_profile(square, fast, sigma, float(least[c])) for sigma in grid]
        for c, (square, fast) in pieces.items()
    }
    cost = np.sum([[own for own, _ in found] for found in best.values()], axis=0)
    return cost, {c: [r for _, r in found] for c, found in best.items()}


def _profile(square: np.ndarray, fast: np.ndarray, sigma: float, least: float) -> tuple[float, float]:
    """Return -2 log likelihood of squared differences under r^2 + sigma^2 fast at the best r, and that r."""
    # 0.455: median of a squared standard normal value.
    scale = max(float(np.median(square)) / 0.455, 1e-2 * float(square.mean()), least**2, 1e-300)
    floor = least**2 / scale
    shares = np.geomspace(1e-5, 10.0, 16)
    for _ in range(2):
        shares = np.maximum(shares, floor)
        costs = [_clipped_cost(square / scale, share + sigma**2 * fast / scale) for share in shares]
        k = int(np.argmin(costs))
        total, best = costs[k], shares[k]
        # Once more between the neighbours: an error of r is read as more or less than noise later.
        shares = np.geomspace(shares[max(k - 1, 0)], shares[min(k + 1, len(shares) - 1)], 16)
    return float(total), float(np.sqrt(scale * best))


def _clipped_cost(square: np.ndarray, variance: np.ndarray) -> float:
    """-2 log likelihood; beyond a clip it grows with the logarithm only: an outlier must not look like jitter."""
    z = square / variance
    far = np.where(z < CLIP, z, CLIP * (1.0 + np.log(np.maximum(z, CLIP) / CLIP)))
    return float((np.log(variance) + far).sum())


def rates(t: np.ndarray, value: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """(W, N, M) rate of change of measurements, by differences over four samples; 0 where there are few.

    Args:
        t: (W, N, M) time stamps [s].
        value: (W, N, M) measurements.
        valid: (W, N, M) True where there is a sample; valid samples come first.
    """
    count = valid.sum(-1, keepdims=True)
    at = np.arange(value.shape[-1])
    low = np.clip(at - 2, 0, np.maximum(count - 5, 0))
    high = np.minimum(low + 4, np.maximum(count - 1, 0))
    gap = np.take_along_axis(t, high, -1) - np.take_along_axis(t, low, -1)
    change = np.take_along_axis(value, high, -1) - np.take_along_axis(value, low, -1)
    usable = valid & (count >= 5) & (gap > 0.0)
    return np.where(usable, change / np.where(gap > 0.0, gap, 1.0), 0.0)


def _normalised_difference(t: np.ndarray, value: np.ndarray, order: int) -> np.ndarray:
    weight, rows = difference_weights(t, order)
    return (weight * value[rows]).sum(axis=1)


def difference_weights(t: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n - order, order + 1) of normalised divided differences, and the samples that they belong to."""
    rows = np.arange(len(t) - order)[:, None] + np.arange(order + 1)
    stamps = t[rows]
    gap = stamps[:, :, None] - stamps[:, None, :]
    gap /= np.abs(gap).max(axis=(1, 2), keepdims=True)
    gap[:, np.arange(order + 1), np.arange(order + 1)] = 1.0
    weight = 1.0 / gap.prod(axis=2)
    weight /= np.linalg.norm(weight, axis=1, keepdims=True)
    return weight, rows


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

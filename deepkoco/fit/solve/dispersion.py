"""Compute size and autocorrelation of the residuals of a fit, relative to independent noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit_types import Fit

# Longest lag of the autocorrelation: the larger of the two. Model error has a correlation time at any sample rate:
# at 1 kHz, 25 samples are too short for it, and its samples would count as independent ones.
LONGEST_LAG = 25  # [samples]
LONGEST_TIME = 0.25  # [s]


@dataclass(frozen=True)
class Dispersion:
    """Size and autocorrelation of residuals, relative to independent noise of the assumed size.

    Attributes:
        chi2_per_sample: Mean squared residual in noise variances.
        correlation: 1 + 2 times the sum of autocorrelations within windows: samples per independent sample.
        lag_one: Autocorrelation at a lag of one sample.
    """

    chi2_per_sample: float
    correlation: float
    lag_one: float

    @property
    def deflation(self) -> float:
        """Factor by which the assumption of white noise overestimates likelihood ratios; at least 1."""
        return max(1.0, self.chi2_per_sample) * self.correlation


def dispersion(fit: Fit, windows: Windows) -> Dispersion:
    """Compute the dispersion of a fit's residuals over all channels and windows."""
    residual, valid = fit.residual.numpy(), windows.valid.numpy()
    rate = float(windows.valid.sum(-1).max()) / windows.length
    longest = min(max(LONGEST_LAG, round(LONGEST_TIME * rate)), residual.shape[-1] - 1)
    totals, counts = np.zeros(longest + 1), np.zeros(longest + 1)
    for lag in range(longest + 1):
        end = residual.shape[-1] - lag
        both = valid[..., :end] & valid[..., lag:]
        totals[lag] = (residual[..., :end] * residual[..., lag:] * both).sum()
        counts[lag] = both.sum()
    samples = counts[0]
    power = totals[0] / max(samples, 1.0)
    rho = totals[1:] / np.maximum(counts[1:], 1.0) / max(power, 1e-300)
    # The sum ends before the first autocorrelation that is not significant (initial positive sequence).
    inside = rho > 2.0 / math.sqrt(max(samples, 1.0))
    reach = int(np.argmin(inside)) if not inside.all() else len(rho)
    return Dispersion(float(power), 1.0 + 2.0 * float(rho[:reach].sum()), float(rho[0]))

"""Separate refits of the healthy logs, and the run-to-run variance of the unit from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Healthy, noisier, refit, tempered
from deepkoco.diagnose.residuals.residuals import mean_square_variance
from deepkoco.diagnose.run_to_run import RunToRun, log_information, sampling_variance, variances_between
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.dispersion import Dispersion, dispersion
from deepkoco.fit.solve.prior import Prior

MIN_WINDOWS_PER_LOG = 3  # windows from which a log has its own parameters
ROUNDS = 10  # largest number of rounds of refits and new floors
SETTLED = 0.9  # ratio of two successive floors from which the rounds end


def run_to_run(healthy: Healthy, prior: Prior) -> RunToRun | None:
    """Refit every healthy log separately and estimate the run-to-run variance.

    Each refit frees the parameters of the pooled fit, and the floor counts as noise. The run-to-run variance starts
    from the variance of the estimates between logs, minus their sampling variance. It ends where the estimates of all
    logs together are most likely, because errors of one log are correlated between its parameters. The floor is chi2
    per sample of each log under the prior that the other logs and this variance give, as in a diagnosis.

    Source: random effects, started by the method of moments (DerSimonian and Laird 1986).

    Args:
        healthy: The logs and their pooled fit.
        prior: Prior of the pooled fit.

    Returns:
        The estimate; None for fewer than two logs that are long enough.
    """
    # A separate refit has no run-to-run variance of its own.
    windows, fit = replace(healthy.windows, varies={}), healthy.fit
    fit = replace(fit, values=FitProblem(healthy.before.system, healthy.windows).values_in(fit))
    healthy = replace(healthy, fit=fit)
    logs = {int(k): windows.take(windows.log == k) for k in np.unique(windows.log)}
    long = np.array([len(own) >= MIN_WINDOWS_PER_LOG for own in logs.values()])
    if long.sum() < 2:
        return None
    # Parameters about which a log says nothing stay at the values of the pooled fit.
    centred = Prior(prior.names, np.array([fit.values[n] for n in prior.names]), prior.covariance)
    pooled = dispersion(fit, windows)
    alone = _refits(
        healthy, list(logs.values()), centred, max(1.0, pooled.chi2_per_sample), pooled.correlation
    )
    for _ in range(ROUNDS):
        before = alone.floor * alone.correlation
        alone = _refits(healthy, list(logs.values()), centred, alone.floor, alone.correlation)
        if alone.floor * alone.correlation > SETTLED * before:
            break
    values = np.array([[fit.values[n] for n in prior.names] for fit in alone.fits])
    pairs = list(zip(alone.fits, alone.spreads, strict=True))
    by_noise = np.array([sampling_variance(fit, alone.prior, s.deflation) for fit, s in pairs])
    alike = np.maximum(np.var(values[long], axis=0, ddof=1) - by_noise[long].mean(0), 0.0)
    told = {
        k: log_information(fit, alone.prior, s.deflation) for k, (fit, s) in zip(logs, pairs, strict=True)
    }
    degrees = int(long.sum()) - 1
    declared = np.diag(prior.covariance)
    those = [told[k] for k, enough in zip(logs, long, strict=True) if enough]
    between = np.diag(variances_between(those, centred, alike))
    found = RunToRun(told, between, degrees, declared, alone.floor, alone.correlation, alone.lag_one)
    again = _refits(healthy, list(logs.values()), found.of_another(prior), found.floor, found.correlation)
    return replace(
        found,
        floor=again.floor,
        correlation=again.correlation,
        lag_one=again.lag_one,
        floor_variance=floor_variance(again.spreads, [own.samples for own in logs.values()]),
    )


def floor_variance(spreads: Sequence[Dispersion], samples: Sequence[int]) -> float:
    """Return by how much the floor of a further log differs from the mean of these, beside chance.

    Args:
        spreads: Dispersion of each log.
        samples: Number of its samples.

    Returns:
        A variance, as a share of the squared mean; the uncertainty of the mean is part of it.
    """
    floors = np.array([s.chi2_per_sample for s in spreads])
    chance = np.mean([mean_square_variance(n, s.correlation) for s, n in zip(spreads, samples, strict=True)])
    between = np.var(floors, ddof=1) / np.mean(floors) ** 2 - chance
    return float(max(between, 0.0) * (1.0 + 1.0 / len(floors)))


class _Refits(NamedTuple):
    """Separate refits of all logs, and the dispersion of their residuals."""

    prior: Prior
    fits: list[Fit]
    spreads: list[Dispersion]
    floor: float

    @property
    def correlation(self) -> float:
        return float(np.mean([s.correlation for s in self.spreads]))

    @property
    def lag_one(self) -> float:
        return float(np.mean([s.lag_one for s in self.spreads]))


def _refits(
    healthy: Healthy, logs: Sequence[Windows], prior: Prior, floor: float, correlation: float
) -> _Refits:
    prior = tempered(prior, correlation)
    start = replace(healthy.before, values=dict(healthy.fit.values), prior=prior)
    noisy = [noisier(own, floor) for own in logs]
    fits = [refit(start, own) for own in noisy]
    chi2, samples = sum(fit.chi2 for fit in fits), sum(own.samples for own in noisy)
    spreads = [dispersion(fit, own) for fit, own in zip(fits, noisy, strict=True)]
    return _Refits(prior, fits, spreads, max(1.0, floor * chi2 / samples))

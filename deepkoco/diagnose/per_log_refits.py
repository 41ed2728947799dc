"""Separate refits of the healthy logs, and the run-to-run variance of the unit from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Healthy, noisier, tempered
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.residuals.residuals import mean_square_variance
from deepkoco.diagnose.run_to_run import (
    RunToRun,
    least_variance,
    log_information,
    sampling_variance,
    unshown,
    with_ratios,
    within_bounds,
)
from deepkoco.diagnose.variances_between import variances_between
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import Dispersion, dispersion
from deepkoco.fit.solve.prior import Prior

MIN_WINDOWS_PER_LOG = 3  # windows from which a log has its own parameters
ROUNDS = 10  # largest number of rounds of refits and new floors
# Times the declared standard deviation up to which a parameter may vary. Nothing stops one that hardly shows.
MOST = 30.0
SETTLED = 0.9  # ratio of two successive floors from which the rounds end


def run_to_run(healthy: Healthy, prior: Prior) -> RunToRun | None:
    """Refit every healthy log separately and estimate the run-to-run variance.

    Each refit frees the parameters of the pooled fit, and the floor counts as noise. The run-to-run variance starts
    from the variance of the estimates between logs, minus their sampling variance. It ends where the estimates of all
    logs together are most likely, because errors of one log are correlated between its parameters.

    Source: random effects, started by the method of moments (DerSimonian and Laird 1986).

    Args:
        healthy: The logs and their pooled fit.
        prior: Prior of the pooled fit.

    Returns:
        The estimate, with the floor that the separate refits leave; None for fewer than two logs that are long enough.
    """
    healthy, logs = _one_by_one(healthy)
    long = np.array([len(own) >= MIN_WINDOWS_PER_LOG for own in logs.values()])
    if long.sum() < 2:
        return None
    # Parameters about which a log says nothing stay at the values of the pooled fit.
    fit = healthy.fit
    centred = replace(prior, centre=np.array([fit.values[n] for n in prior.names]))
    pooled = dispersion(fit, healthy.windows)
    alone = _refits(healthy, logs, centred, max(1.0, pooled.chi2_per_sample), pooled.correlation)
    for _ in range(ROUNDS):
        before = alone.floor * alone.correlation
        alone = _refits(healthy, logs, centred, alone.floor, alone.correlation)
        if alone.floor * alone.correlation > SETTLED * before:
            break
    values = np.array([[fit.values[n] for n in prior.names] for fit in alone.fits])
    pairs = list(zip(alone.fits, alone.deflations(list(logs.values())), strict=True))
    by_noise = np.array([sampling_variance(fit, alone.prior, deflation) for fit, deflation in pairs])
    alike = np.maximum(np.var(values[long], axis=0, ddof=1) - by_noise[long].mean(0), 0.0)
    told = {}
    for (k, own), (alone_fit, deflation) in zip(logs.items(), pairs, strict=True):
        shared = _at_pooled(healthy, noisier(own, alone.noise), alone_fit, alone.prior)
        told[k] = log_information(alone_fit, alone.prior, deflation, shared)
    kept = [g.fixed for g in healthy.before.gauges]
    those = [told[k] for k, enough in zip(logs, long, strict=True) if enough]
    most = np.array([(MOST * healthy.before.system.parameter(n).prior_sd) ** 2 for n in prior.names])
    usual = np.diag(unshown(healthy.before.system, prior.names, fit.values, kept))
    between = np.diag(variances_between(those, centred, alike, most, usual))
    return RunToRun(
        told,
        between,
        int(long.sum()) - 1,
        alone.floor,
        alone.correlation,
        alone.lag_one,
        least=least_variance(healthy.before.system, prior.names, fit.values, kept),
    )


def with_floor(runs: RunToRun, healthy: Healthy, prior: Prior) -> RunToRun:
    """Return the run-to-run variance with the mean of a fit to all logs, and with the floor that this mean leaves.

    The floor is chi2 per sample of each log under the prior that the logs and their variance give, as in a diagnosis.

    Args:
        runs: The variance.
        healthy: The logs and their fit under this variance.
        prior: Prior of a log's parameters, before any log.
    """
    fit = healthy.fit
    runs = replace(runs, mean=np.array([fit.values[n] for n in prior.names]))
    healthy, logs = _one_by_one(healthy)
    system = healthy.before.system
    another = with_ratios(within_bounds(runs.of_another(prior), system), system)
    again = _refits(healthy, logs, another, runs.floor, runs.correlation)
    return replace(
        runs,
        floor=again.floor,
        correlation=again.correlation,
        lag_one=again.lag_one,
        floor_variance=floor_variance(again.spreads, [own.samples for own in logs.values()]),
    )


def _one_by_one(healthy: Healthy) -> tuple[Healthy, dict[int, Windows]]:
    """Return healthy logs without run-to-run variance of their own, and the windows of each."""
    windows, fit = replace(healthy.windows, varies={}), healthy.fit
    fit = replace(fit, values=FitProblem(healthy.before.system, healthy.windows).values_in(fit))
    logs = {int(k): windows.take(windows.log == k) for k in np.unique(windows.log)}
    return replace(healthy, windows=windows, fit=fit), logs


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
    """Separate refits of all logs, and the dispersion of their residuals; ``noise`` is the floor that they counted."""

    prior: Prior
    fits: list[Fit]
    spreads: list[Dispersion]
    floor: float
    noise: float

    @property
    def correlation(self) -> float:
        return float(np.mean([s.correlation for s in self.spreads]))

    @property
    def lag_one(self) -> float:
        return float(np.mean([s.lag_one for s in self.spreads]))

    def deflations(self, logs: Sequence[Windows]) -> list[float]:
        """Return the deflation of each log's likelihood, over its degrees of freedom.

        A log of 900 samples whose residuals last for 60 of them has fifteen independent ones, of which seven parameters
        take half. What they leave is then half of the model error.

        Source: residual variance of a linear regression, with effective parameters (Moody 1992): tr(C H).
        """
        precision, found = self.prior.precision(self.prior.names), []
        for fit, spread, own in zip(self.fits, self.spreads, logs, strict=True):
            index = [fit.free.index(n) for n in self.prior.names]
            free = len(index) - float(np.trace(fit.covariance[np.ix_(index, index)] @ precision))
            independent = own.samples / spread.correlation
            found.append(spread.deflation * independent / max(independent - free, 1.0))
        return found


def _refits(
    healthy: Healthy, logs: Mapping[int, Windows], prior: Prior, floor: float, correlation: float
) -> _Refits:
    prior = tempered(prior, correlation)
    start = replace(healthy.before, values=dict(healthy.fit.values), prior=prior)
    noisy = [noisier(own, floor) for own in logs.values()]
    fits = [refit(start, own) for own in noisy]
    chi2, samples = sum(fit.chi2 for fit in fits), sum(own.samples for own in noisy)
    spreads = [dispersion(fit, own) for fit, own in zip(fits, noisy, strict=True)]
    return _Refits(prior, fits, spreads, max(1.0, floor * chi2 / samples), floor)


def _at_pooled(healthy: Healthy, windows: Windows, own: Fit, prior: Prior) -> Fit | None:
    """Return a log at the values of the pooled fit; None if its simulation diverges there.

    Args:
        healthy: The logs and their pooled fit.
        windows: The windows of one log.
        own: Their separate refit, whose initial states are near.
        prior: Its prior.
    """
    problem, values = FitProblem(healthy.before.system, windows), healthy.fit.values
    state, _ = problem.fit_states(values, own.state)
    fit = problem.fit([Trial(own.name, own.free, prior, values, state, own.nuisance)], 1)[0]
    return None if fit.diverged else fit

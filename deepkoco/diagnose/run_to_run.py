"""What differs between logs of one healthy unit, and how large its model error is within a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Healthy, noisier, refit, tempered
from deepkoco.identify.dispersion import Dispersion, dispersion
from deepkoco.identify.fit import Fit
from deepkoco.identify.prior import Prior
from deepkoco.identify.windows import Windows

FEWEST_OF_A_LOG = 3  # windows from which on a log has parameters of its own
ROUNDS = 10  # of fits and the floor that weighs them, at most
SETTLED = 0.9  # share of the floor before, from which on they have settled


class Said(NamedTuple):
    """What the data of one log say of the parameters: a normal distribution in information form.

    Attributes:
        information: (K, K) inverse covariance; 0 in directions of which the log says nothing.
        times_mean: (K,) its product with the estimate.
    """

    information: np.ndarray
    times_mean: np.ndarray


@dataclass(frozen=True)
class RunToRun:
    """What healthy logs of one unit show when each has parameters of its own.

    Attributes:
        said: By the number of a log, what it says of its parameters.
        covariance: (K, K) diagonal, by which parameters differ between logs.
        floor: chi2 per sample that is left in each.
        correlation: Samples per independent sample of what is left.
        lag_one: Correlation of neighbouring residuals.
    """

    said: dict[int, Said]
    covariance: np.ndarray
    floor: float
    correlation: float
    lag_one: float

    def of_another(self, prior: Prior, without: int | None = None) -> Prior:
        """What these logs say of the parameters of another one.

        Each tells of the mean as far as it knows its own parameters and these do not differ from it.

        Args:
            prior: Of the mean, before any log.
            without: Number of a log that is left out.
        """
        precision = prior.precision(prior.names)
        times_mean = precision @ prior.centre
        one = np.eye(len(precision))
        for log, own in self.said.items():
            if log != without:
                through = np.linalg.inv(one + own.information @ self.covariance)
                precision = precision + through @ own.information
                times_mean = times_mean + through @ own.times_mean
        covariance = _inverse(precision)
        return Prior(prior.names, covariance @ times_mean, covariance + self.covariance)


def run_to_run(healthy: Healthy, prior: Prior) -> RunToRun | None:
    """Refit every healthy log by itself; None for less than two that are long enough.

    Everything is free that the pooled fit freed, and the model-error floor counts as noise. What the logs differ by
    beyond what that moves their estimates by is the unit's own spread. The floor is what is left of each log under
    all that is known of another log then, as it is in a diagnosis.

    Source: random effects by the method of moments (DerSimonian and Laird 1986).

    Args:
        healthy: The logs and their pooled fit.
        prior: What the pooled fit began with.
    """
    windows, fit = healthy.windows, healthy.fit
    logs = {int(k): windows.take(windows.log == k) for k in np.unique(windows.log)}
    logs = {k: own for k, own in logs.items() if len(own) >= FEWEST_OF_A_LOG}
    if len(logs) < 2:
        return None
    # A log that says nothing of a parameter is to stay where all of them together are.
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
    values = [[fit.values[n] for n in prior.names] for fit in alone.fits]
    pairs = list(zip(alone.fits, alone.spreads, strict=True))
    by_noise = np.mean([sampling_variance(fit, alone.prior, s.deflation) for fit, s in pairs], axis=0)
    between = np.diag(np.maximum(np.var(values, axis=0, ddof=1) - by_noise, 0.0))
    said = {k: _said(fit, alone.prior, s.deflation) for k, (fit, s) in zip(logs, pairs, strict=True)}
    found = RunToRun(said, between, alone.floor, alone.correlation, alone.lag_one)
    again = _refits(healthy, list(logs.values()), found.of_another(prior), found.floor, found.correlation)
    return replace(found, floor=again.floor, correlation=again.correlation, lag_one=again.lag_one)


class _Refits(NamedTuple):
    """Every log refitted by itself, and what that leaves."""

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


def sampling_variance(fit: Fit, prior: Prior, deflation: float) -> np.ndarray:
    """(K,) variance by which noise moves the estimates of a fit under a prior that stays where it is.

    With the posterior covariance C and the prior's P the data say H = C^-1 - P^-1, and noise moves the estimates by
    C H C: by nothing where the prior holds them, by all of C where the data do.

    Args:
        fit: The fit.
        prior: Its prior.
        deflation: Variance of the residuals and their correlation, in those of white noise of the assumed size.
    """
    c = _covariance(fit, prior)
    return deflation * np.maximum(np.diag(c - c @ prior.precision(prior.names) @ c), 0.0)


def posterior(fit: Fit, prior: Prior, deflation: float) -> np.ndarray:
    """(K, K) covariance of a fit whose data count for less; never wider than the prior.

    With C, P and H as in :func:`sampling_variance` it is (H / deflation + P^-1)^-1.

    Args:
        fit: The fit.
        prior: Its prior.
        deflation: Variance of the residuals and their correlation, in those of white noise of the assumed size.
    """
    c = _covariance(fit, prior)
    less = np.eye(len(c)) + (deflation - 1.0) * prior.precision(prior.names) @ c
    wider = deflation * np.linalg.solve(less.T, c)
    return 0.5 * (wider + wider.T)


def _said(fit: Fit, prior: Prior, deflation: float) -> Said:
    """What the data of a fit say, its prior taken out."""
    precision, both = prior.precision(prior.names), _inverse(_covariance(fit, prior))
    values = np.array([fit.values[n] for n in prior.names])
    return Said((both - precision) / deflation, (both @ values - precision @ prior.centre) / deflation)


def _covariance(fit: Fit, prior: Prior) -> np.ndarray:
    order = [fit.free.index(n) for n in prior.names]
    return fit.covariance[np.ix_(order, order)]


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a symmetric matrix whose rows have units of their own."""
    scale = np.sqrt(np.diag(matrix))
    inverse = np.linalg.pinv(matrix / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return 0.5 * (inverse + inverse.T)

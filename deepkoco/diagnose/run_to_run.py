"""What logs of one unit say of another log of it, where parameters differ from run to run.

Source: random effects (DerSimonian and Laird 1986), in the information form of normal distributions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.optimize
import scipy.stats

from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import scaled_inverse
from deepkoco.systems import System


class LogInformation(NamedTuple):
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
        log_information: By the number of a log, what it says of its parameters.
        covariance: (K, K) diagonal, by which parameters differ between logs. What moves several of them together is
            spread over them, and comes out low by that.
        degrees: Of freedom of this estimate.
        declared: (K,) variance of what was declared of a unit's parameters, before any log.
        floor: chi2 per sample that is left in each.
        correlation: Samples per independent sample of what is left.
        lag_one: Correlation of neighbouring residuals.
    """

    log_information: dict[int, LogInformation]
    covariance: np.ndarray
    degrees: int
    declared: np.ndarray
    floor: float
    correlation: float
    lag_one: float

    def of_another(self, prior: Prior, without: int | None = None) -> Prior:
        """What these logs say of the parameters of another one.

        Each tells of the mean as far as it knows its own parameters and these do not differ from it. How much logs
        differ is known from a few of them only: their spread is doubted (:attr:`doubted`).

        What is declared of a unit's parameters is meant for every log of it. Where these vary by more, their mean is
        not known that well either.

        Args:
            prior: Of a log's parameters, before any log.
            without: Number of a log that is left out.
        """
        one, differ = np.eye(len(prior.names)), self.doubted
        before = Prior(prior.names, prior.centre, prior.covariance + differ)
        precision = before.precision(prior.names)
        times_mean = precision @ prior.centre
        for log, own in self.log_information.items():
            if log != without:
                through = np.linalg.inv(one + own.information @ differ)
                precision = precision + through @ own.information
                times_mean = times_mean + through @ own.times_mean
        covariance = _inverse(precision)
        return Prior(prior.names, covariance @ times_mean, covariance + differ)

    @property
    def doubted(self) -> np.ndarray:
        """(K, K) diagonal covariance by which logs may differ, seeing that it is known from a few only.

        Doubt goes as far as what was declared: beyond that logs differ by what they show.
        """
        sure = scipy.stats.t.ppf(0.975, self.degrees) / scipy.stats.norm.ppf(0.975)
        shown = np.diag(self.covariance)
        return np.diag(np.minimum(sure**2 * shown, np.maximum(shown, self.declared)))


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


def log_information(fit: Fit, prior: Prior, deflation: float) -> LogInformation:
    """What the data of a fit say, its prior taken out."""
    precision, both = prior.precision(prior.names), _inverse(_covariance(fit, prior))
    values = np.array([fit.values[n] for n in prior.names])
    return LogInformation(
        (both - precision) / deflation, (both @ values - precision @ prior.centre) / deflation
    )


def within_bounds(prior: Prior, system: System) -> Prior:
    """A prior with its mean at the most probable place where the system's parameters may be.

    What is known of a sum of parameters stays so: one that is moved to its bound takes the others along.

    Args:
        prior: (K,) mean and (K, K) covariance, in the parameters' units; the covariance stays as it is.
        system: Declares the bounds.
    """
    declared = [system.parameter(n) for n in prior.names]
    low, high = (np.array([getattr(p, side) for p in declared]) for side in ("low", "high"))
    if ((prior.centre >= low) & (prior.centre <= high)).all():
        return prior
    scale = np.sqrt(np.diag(prior.covariance))
    # Directions that are hardly known may come out a little negative.
    weight, ways = np.linalg.eigh(prior.precision(prior.names) * np.outer(scale, scale))
    root = np.sqrt(np.maximum(weight, 0.0))[:, None] * ways.T
    at = scipy.optimize.lsq_linear(
        root, root @ (prior.centre / scale), (low / scale, high / scale), tol=1e-12
    ).x
    return Prior(prior.names, np.clip(at * scale, low, high), prior.covariance)


def _covariance(fit: Fit, prior: Prior) -> np.ndarray:
    order = [fit.free.index(n) for n in prior.names]
    return fit.covariance[np.ix_(order, order)]


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Scaled inverse, symmetric to the last bit."""
    inverse = scaled_inverse(matrix)
    return 0.5 * (inverse + inverse.T)

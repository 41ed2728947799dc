"""Prior for one log from other logs of the same unit, whose parameters differ from run to run.

Source: random effects (DerSimonian and Laird 1986), in the information form of normal distributions.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.optimize
import scipy.stats

from deepkoco.diagnose.causes.tolerance import usual_sd
from deepkoco.fit.data.per_log_differences import may_differ
from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import symmetric_inverse
from deepkoco.systems import System

# Run-to-run standard deviation that a single log leaves open, over the declared one: a few per cent of a gain. Each
# parameter is doubted by itself, so its products with others, which the logs know better, become uncertain as well.
USUAL = 0.1
LEFT_OPEN = (
    0.5  # of the standard deviation that a single log leaves open, which several logs that agree leave
)


class LogInformation(NamedTuple):
    """Likelihood of one log in its parameters: a normal distribution in information form.

    Attributes:
        information: (K, K) inverse covariance; 0 in directions about which the log says nothing.
        times_mean: (K,) its product with the estimate.
    """

    information: np.ndarray
    times_mean: np.ndarray


@dataclass(frozen=True)
class RunToRun:
    """Run-to-run variance of a unit, estimated from separate refits of its healthy logs.

    Attributes:
        log_information: Number of a log -> likelihood of that log in its parameters.
        covariance: (K, K) diagonal run-to-run covariance. A common cause that moves several parameters together is
            spread over them and therefore underestimated.
        degrees: Degrees of freedom of this estimate.
        floor: chi2 per sample that remains in the logs.
        correlation: Samples per independent sample of the residuals.
        lag_one: Correlation of neighbouring residuals.
        floor_variance: Variance of the floor of one further log as a share of the squared floor, from how far the
            floors of these logs differ beyond chance; it contains that of their mean.
        mean: (K,) mean that the fit of all logs together found, each with parameters of its own; None for the mean of
            their likelihoods. A fit follows the curved valley of a product that all logs tell; a sum of normal
            distributions leaves it along a tangent.
        least: (K,) run-to-run variance that no few logs exclude (:func:`least_variance`); None for none.
    """

    log_information: dict[int, LogInformation]
    covariance: np.ndarray
    degrees: int
    floor: float
    correlation: float
    lag_one: float
    floor_variance: float = 0.0
    mean: np.ndarray | None = None
    least: np.ndarray | None = None

    def of_another(self, prior: Prior, without: int | None = None) -> Prior:
        """Return the prior that these logs give for the parameters of another log.

        Each log informs about the mean. Its weight falls with its own uncertainty and with the run-to-run variance.
        Few logs estimate that variance poorly, so the inflated one is used (:attr:`doubted`).

        The declared prior holds for every single log of the unit. The prior of the mean is wider by the run-to-run
        variance.

        Args:
            prior: Prior of a log's parameters, before any log.
            without: Number of a log that is left out.
        """
        centre, covariance = self._of_mean(prior, without)
        if self.mean is not None:
            # What leaving out a log changes is small enough for tangents.
            centre = self.mean if without is None else self.mean + centre - self._of_mean(prior, None)[0]
        return replace(prior, centre=centre, covariance=covariance + self.differ)

    @property
    def differ(self) -> np.ndarray:
        """(K, K) diagonal covariance by which a further log differs from the mean: inflated, and at least the usual."""
        return self.doubted if self.least is None else np.maximum(self.doubted, np.diag(self.least))

    def _of_mean(self, prior: Prior, without: int | None) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (K,) and covariance (K, K) of the mean, from the likelihoods of all logs but one."""
        one, differ = np.eye(len(prior.names)), self.doubted
        before = replace(prior, covariance=prior.covariance + differ)
        precision = before.precision(prior.names)
        times_mean = precision @ prior.centre
        for log, own in self.log_information.items():
            if log != without:
                through = np.linalg.inv(one + own.information @ differ)
                precision = precision + through @ own.information
                times_mean = times_mean + through @ own.times_mean
        covariance = symmetric_inverse(precision)
        return covariance @ times_mean, covariance

    @property
    def doubted(self) -> np.ndarray:
        """(K, K) diagonal run-to-run covariance, inflated because few logs estimate it poorly.

        The variance is the median of its posterior under a half-Cauchy prior of the standard deviation
        (:func:`.variances_between`). With n degrees of freedom and the squares S, that is S / (n + 1/3), and a further
        log follows Student's t with n + 1 degrees and the squared scale S / (n + 1). The result is the variance of
        the normal distribution with the same 95 % interval.
        """
        degrees = self.degrees + 1
        sure = scipy.stats.t.ppf(0.975, degrees) / scipy.stats.norm.ppf(0.975)
        return np.diag(sure**2 * (1.0 - 2.0 / (3.0 * degrees)) * np.diag(self.covariance))


def unshown(
    system: System, names: Sequence[str], values: Mapping[str, float], kept: Collection[str] = ()
) -> np.ndarray:
    """Return the run-to-run covariance (K, K) that a single healthy log leaves open.

    It is what few logs leave open at most, and no more than units of one make differ by. Of an effect that the unit
    has, that is a share of what it has.

    Args:
        system: Declares the parameters.
        names: K parameters; what cannot vary, such as a delay, has 0.
        values: Their values in the healthy logs.
        kept: Those that fix a scale: all others are counted by them, so they do not vary.
    """
    may = may_differ(system).difference(kept)
    own = [system.parameter(n) for n in names]
    usual = [usual_sd(replace(p, value=values[p.name])) for p in own]
    return np.diag(
        [min(USUAL * p.prior_sd, sd) ** 2 if p.name in may else 0.0 for p, sd in zip(own, usual, strict=True)]
    )


def least_variance(
    system: System, names: Sequence[str], values: Mapping[str, float], kept: Collection[str] = ()
) -> np.ndarray:
    """Return the run-to-run variance (K,) of a unit that few logs do not exclude, although they agree.

    Copper and magnets change by some tenths of a per cent with each kelvin, and friction by more. Three short logs of
    one hour agree to a few per mille, and a log of the next day does not. It is that of a single log
    (:func:`unshown`) with half of its standard deviation.

    Args:
        system: Declares the parameters.
        names: K parameters.
        values: Their values in the healthy logs.
        kept: Those that fix a scale.
    """
    return LEFT_OPEN**2 * np.diag(unshown(system, names, values, kept))


def sampling_variance(fit: Fit, prior: Prior, deflation: float) -> np.ndarray:
    """Return the variance (K,) that noise causes in the estimates of a fit under a fixed prior.

    With the covariance C of the posterior and P of the prior, the information of the data is H = C^-1 - P^-1. Noise
    causes the covariance C H C. It is 0 where the prior determines an estimate, and C where the data do.

    Args:
        fit: The fit.
        prior: Its prior.
        deflation: Deflation of the residuals: chi2 per sample times samples per independent sample.
    """
    c = _covariance(fit, prior)
    return deflation * np.maximum(np.diag(c - c @ prior.precision(prior.names) @ c), 0.0)


def posterior(fit: Fit, prior: Prior, deflation: float, of_fit: Prior | None = None) -> np.ndarray:
    """Return the covariance (K, K) of a fit with the information of its data deflated; never wider than the prior.

    With the covariance C of the fit, its prior P and H = C^-1 - P^-1, it is (H / deflation + prior^-1)^-1.

    Args:
        fit: The fit.
        prior: The prior that counts.
        deflation: Deflation of the residuals: chi2 per sample times samples per independent sample.
        of_fit: P, with the same parameters; None for the prior that counts.
    """
    c, counts = _covariance(fit, prior), prior.precision(prior.names)
    before = counts if of_fit is None else of_fit.precision(prior.names)
    less = np.eye(len(c)) + (deflation * counts - before) @ c
    wider = deflation * np.linalg.solve(less.T, c)
    return 0.5 * (wider + wider.T)


def log_information(fit: Fit, prior: Prior, deflation: float, shared: Fit | None = None) -> LogInformation:
    """Return the likelihood of a fit's data in its parameters: the posterior with the prior removed.

    Logs that tell only a product of parameters each leave a curved valley. Its tangents at different points cross, as
    if the logs together told the single parameters. Slopes at one point that all logs share leave the same direction
    open.

    Args:
        fit: The fit.
        prior: Its prior.
        deflation: Deflation of the residuals: chi2 per sample times samples per independent sample.
        shared: The same log at the shared point, under the same prior; None for slopes at the fit's own values.
    """
    at = fit if shared is None else shared
    precision, both = prior.precision(prior.names), symmetric_inverse(_covariance(at, prior))
    values = np.array([fit.values[n] for n in prior.names])
    return LogInformation(
        (both - precision) / deflation, (both @ values - precision @ prior.centre) / deflation
    )


def within_bounds(prior: Prior, system: System) -> Prior:
    """Return a prior with its mean moved to the most probable point inside the parameters' bounds.

    Correlated parameters move together, so a known sum of parameters is kept when one of them moves to its bound.

    Args:
        prior: (K,) mean and (K, K) covariance, in the parameters' units; the covariance stays as it is.
        system: Declares the bounds.
    """
    declared = [system.parameter(n) for n in prior.names]
    low, high = (np.array([getattr(p, side) for p in declared]) for side in ("low", "high"))
    if ((prior.centre >= low) & (prior.centre <= high)).all():
        return prior
    scale = np.sqrt(np.diag(prior.covariance))
    # Rounding can make the smallest eigenvalues slightly negative.
    weight, ways = np.linalg.eigh(prior.precision(prior.names) * np.outer(scale, scale))
    root = np.sqrt(np.maximum(weight, 0.0))[:, None] * ways.T
    at = scipy.optimize.lsq_linear(
        root, root @ (prior.centre / scale), (low / scale, high / scale), tol=1e-12
    ).x
    return replace(prior, centre=np.clip(at * scale, low, high))


def with_ratios(prior: Prior, system: System) -> Prior:
    """Return a learned prior in which parameters that cannot be 0 are log-normal.

    Logs of a motor tell the ratio of its torque constant and its resistance better than each of them. Far from what
    was learned, a normal distribution would give up this ratio.

    Args:
        prior: The prior, within the bounds of its parameters.
        system: Declares the bounds.
    """
    positive = {
        n for n, c in zip(prior.names, prior.centre, strict=True) if system.parameter(n).low > 0.0 < c
    }
    return replace(prior, lognormal=frozenset(positive))


def _covariance(fit: Fit, prior: Prior) -> np.ndarray:
    order = [fit.free.index(n) for n in prior.names]
    return fit.covariance[np.ix_(order, order)]

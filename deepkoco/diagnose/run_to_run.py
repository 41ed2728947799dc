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
from deepkoco.fit.solve.scaled_inverse import scaled_inverse
from deepkoco.systems import System

STEPS = 200  # of the search for the most likely run-to-run variances
SETTLED = 1e-4  # relative change of every variance from which that search ends
# Share of the prior's information that counts: logs that agree far from it would else seem to differ from run to run.
VAGUE = 0.01
# Run-to-run standard deviation that few logs may leave open, over the declared one: a few per cent of a gain. Each
# parameter is doubted by itself, so its products with others, which the logs know better, become uncertain as well.
USUAL = 0.1
LEFT_OPEN = (
    0.5  # of the standard deviation that a single log leaves open, which several logs that agree leave
)
NOTHING = 1e-9  # of a variance that logs tell nothing about: its information times the variance itself
LEAST = 1e-4  # variance over the declared one from which a search starts that no variance of 0 stops
CLEARLY = 3.0  # by which the logarithm of the likelihood must be larger, so that what it ends at counts
NONE = 1e-6  # variance over the declared one, below which there is none


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
        declared: (K,) declared variance of the parameters, before any log.
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
    declared: np.ndarray
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
        covariance = _inverse(precision)
        return covariance @ times_mean, covariance

    @property
    def doubted(self) -> np.ndarray:
        """(K, K) diagonal run-to-run covariance, inflated because few logs estimate it poorly.

        The standard deviation is multiplied by the ratio of Student's t to the normal quantile, but it is not made
        larger than ``USUAL`` of the declared one. The declared one says how well a data sheet knows a unit; one unit
        differs less from itself from day to day. A sample variance above that is used without inflation.
        """
        sure = scipy.stats.t.ppf(0.975, self.degrees) / scipy.stats.norm.ppf(0.975)
        shown = np.diag(self.covariance)
        return np.diag(np.minimum(sure**2 * shown, np.maximum(shown, USUAL**2 * self.declared)))


def variances_between(
    told: Sequence[LogInformation],
    prior: Prior,
    start: np.ndarray,
    most: np.ndarray | None = None,
    usual: np.ndarray | None = None,
) -> np.ndarray:
    """Return the run-to-run variances (K,) under which the estimates of all logs together are most likely.

    Parameters that one log only knows in combination (a torque constant and a resistance of which the ratio shows)
    are estimated with correlated errors. Taken one by one, both seem to differ from run to run, and their ratio would
    then seem to differ too. The joint likelihood explains such differences by the correlated errors.

    With the information H_k of log k, W_k = (1 + H_k S)^-1 H_k is that of the mean, and the mean m is integrated out.
    Each step multiplies a variance by the root of sum_k (W_k (x_k - m))^2 / sum_k (W_k - W_k L^-1 W_k), where L is the
    information of all logs and ``VAGUE`` of the prior's: the logs alone tell where the mean is, if they can.

    Two or three logs say little about a variance, and a model error that differs between their motions looks like one.
    A standard deviation far above what units of one make differ by must therefore explain much: it has a half-Cauchy
    prior with that scale.

    Source: Zhou et al., MM algorithms for variance components models (2019), restricted likelihood; Gelman, Prior
    distributions for variance parameters in hierarchical models (2006), half-Cauchy.

    A variance of 0 stays 0. Parameters of which the logs tell a sum alone seem not to differ one by one, although their
    sum does. A second search therefore starts with all variances above 0, and counts where the logs are more likely
    with it (``CLEARLY``).

    Args:
        told: Likelihoods of the logs.
        prior: Prior of the mean of K parameters, before any log.
        start: (K,) variances to start from, in the squared units of the parameters.
        most: (K,) largest variances; None for no limit.
        usual: (K,) usual variances, the squared scales of half-Cauchy priors of the standard deviations; None for none.
    """
    scale = np.sqrt(np.diag(prior.covariance))
    differences = Differences(
        [_positive(o.information * np.outer(scale, scale)) for o in told],
        [scale * (o.times_mean - o.information @ prior.centre) for o in told],
        VAGUE * prior.precision(prior.names) * np.outer(scale, scale),
        np.full(len(scale), np.inf) if most is None else most / scale**2,
        np.full(len(scale), np.inf) if usual is None else usual / scale**2,
    )
    found = differences.search(start / scale**2)
    if (found == 0.0).any():
        wider = differences.search(np.maximum(start / scale**2, LEAST))
        if differences.log_likelihood(wider) > differences.log_likelihood(found) + CLEARLY:
            found = wider
    return found * scale**2


class Differences(NamedTuple):
    """Likelihoods of logs in parameters that are counted in declared standard deviations from their prior mean.

    Source: as for :func:`variances_between`.

    Attributes:
        data: (K, K) information of each log.
        pulls: (K,) its product with the estimate.
        before: (K, K) information of the prior that counts.
        limit: (K,) largest variances.
        usual: (K,) usual variances: squared scales of the half-Cauchy priors of the standard deviations.
    """

    data: list[np.ndarray]
    pulls: list[np.ndarray]
    before: np.ndarray
    limit: np.ndarray
    usual: np.ndarray

    def search(self, variance: np.ndarray) -> np.ndarray:
        """Return the most likely variances (K,) from a start; those below ``NONE`` are 0."""
        variance = np.minimum(variance, self.limit)
        for _ in range(STEPS):
            through, known, spread, mean = self._mean(variance)
            shown = np.zeros_like(variance)
            expected = np.zeros_like(variance)
            for t, own, weight, pull in zip(through, self.data, known, self.pulls, strict=True):
                shown += (t @ (pull - own @ mean)) ** 2
                expected += np.diag(weight - weight @ spread @ weight)
            # The slope of -2 log of a half-Cauchy density; it falls with the variance, so a step never overshoots.
            expected = np.maximum(expected, 0.0) + 2.0 / np.maximum(self.usual + variance, NONE)
            # About the variance of a parameter that hardly shows, both sums are rounding errors; it stays.
            less = NOTHING / np.maximum(variance, NONE)
            ratio = (shown + less) / (expected + less)
            found = np.minimum(variance * np.sqrt(ratio), self.limit)
            settled = np.abs(found - variance) <= SETTLED * np.maximum(found, NONE)
            variance = found
            if settled.all():
                break
        return np.where(variance > NONE, variance, 0.0)

    def log_likelihood(self, variance: np.ndarray) -> float:
        """Return the restricted log likelihood of variances (K,) plus their log prior, up to a constant."""
        through, _, spread, mean = self._mean(variance)
        within = sum(p @ (variance[:, None] * t) @ p for t, p in zip(through, self.pulls, strict=True))
        pull = np.sum([t @ p for t, p in zip(through, self.pulls, strict=True)], axis=0)
        volume = sum(np.linalg.slogdet(t)[1] for t in through) + np.linalg.slogdet(spread)[1]
        doubt = float(np.log1p(variance / np.maximum(self.usual, NONE)).sum())
        return 0.5 * float(within + pull @ mean + volume) - doubt

    def _mean(
        self, variance: np.ndarray
    ) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray, np.ndarray]:
        """Return (1 + H_k S)^-1 and its product with H_k for each log, and the covariance and value of the mean."""
        through = [np.linalg.inv(np.eye(len(variance)) + own * variance) for own in self.data]
        known = [t @ own for t, own in zip(through, self.data, strict=True)]
        spread = _inverse(self.before + np.sum(known, axis=0))
        pull = np.sum([t @ p for t, p in zip(through, self.pulls, strict=True)], axis=0)
        return through, known, spread, spread @ pull


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
    precision, both = prior.precision(prior.names), _inverse(_covariance(at, prior))
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


def _positive(matrix: np.ndarray) -> np.ndarray:
    """Return a symmetric matrix without the negative eigenvalues that rounding errors leave."""
    weight, ways = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return (ways * np.maximum(weight, 0.0)) @ ways.T


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Scaled inverse, symmetric to the last bit."""
    inverse = scaled_inverse(matrix)
    return 0.5 * (inverse + inverse.T)

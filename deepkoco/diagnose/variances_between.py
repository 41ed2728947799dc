"""Run-to-run variances of parameters from the likelihoods of several logs, by restricted likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.run_to_run import LogInformation
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import symmetric_inverse

STEPS = 200  # of the search for the most likely run-to-run variances
SETTLED = 1e-4  # relative change of every variance from which that search ends
# Share of the prior's information that counts: logs that agree far from it would else seem to differ from run to run.
VAGUE = 0.01
NOTHING = 1e-9  # of a variance that logs tell nothing about: its information times the variance itself
LEAST = 1e-4  # variance over the declared one from which a search starts that no variance of 0 stops
CLEARLY = 3.0  # by which the logarithm of the likelihood must be larger, so that what it ends at counts
# Share of the logarithm of a half-Cauchy density that counts. The density falls with the squared standard deviation, so
# with n degrees of freedom the variance has the median S / (n + 1/3). With this share its most likely value is there.
DOUBT = 1.0 / 6.0
NONE = 1e-6  # variance over the declared one, below which there is none


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
    A standard deviation far above what units of one make differ by must therefore explain more: it has a half-Cauchy
    prior with that scale, and the result is near the median of what the logs leave.

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
            # The prior's share of the slope of -2 log likelihood falls with the variance, so no step overshoots.
            expected = np.maximum(expected, 0.0) + 2.0 * DOUBT / np.maximum(self.usual + variance, NONE)
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
        return 0.5 * float(within + pull @ mean + volume) - DOUBT * doubt

    def _mean(
        self, variance: np.ndarray
    ) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray, np.ndarray]:
        """Return (1 + H_k S)^-1 and its product with H_k for each log, and the covariance and value of the mean."""
        through = [np.linalg.inv(np.eye(len(variance)) + own * variance) for own in self.data]
        known = [t @ own for t, own in zip(through, self.data, strict=True)]
        spread = symmetric_inverse(self.before + np.sum(known, axis=0))
        pull = np.sum([t @ p for t, p in zip(through, self.pulls, strict=True)], axis=0)
        return through, known, spread, spread @ pull


def _positive(matrix: np.ndarray) -> np.ndarray:
    """Return a symmetric matrix without the negative eigenvalues that rounding errors leave."""
    weight, ways = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return (ways * np.maximum(weight, 0.0)) @ ways.T

"""Fit one normal law to unmeasured delays by marginal likelihood in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar, root_scalar

from deepkoco.fit.delays.linear_delays import SMALLEST_SPREAD, LinearDelays

LARGEST_SPREAD = 1.0  # largest standard deviation of the law [s]
PLACES = 80  # number of spreads at which the likelihood is evaluated before its maximum is refined
DROP_95 = 1.920729410347062  # decrease of the log likelihood at the ends of a 95 % interval: chi2(1) / 2


@dataclass(frozen=True)
class NormalLaw:
    """A normal law of the delays.

    Attributes:
        mean: Mean [s].
        spread: Standard deviation [s], at least :data:`.SMALLEST_SPREAD`.
        mean_sd: Standard error of the mean at this spread [s].
        spread_interval: 95 % interval of the spread [s], by profile likelihood; it begins at 0 if the data do not
            exclude a constant delay.
        evidence: Twice the difference of the log marginal likelihoods of this law and of a constant delay.
    """

    mean: float
    spread: float
    mean_sd: float
    spread_interval: tuple[float, float]
    evidence: float


def normal_law(linear: LinearDelays) -> NormalLaw:
    r"""Maximise the marginal likelihood of the delays over mean and spread.

    In the eigenvectors of a window's information A = V diag(l) V', with u = V' 1 and g = V' h, the log marginal
    likelihood of a mean m and a spread s is a sum over all eigenvalues,

    .. math:: \sum_i m \frac{u_i g_i}{d_i} - \frac{m^2}{2} \frac{l_i u_i^2}{d_i} + \frac{s^2}{2} \frac{g_i^2}{d_i}
        - \frac{1}{2} \log d_i, \quad d_i = 1 + s^2 l_i,

    so the best mean at each spread is a ratio of two sums. Only the spread is searched.

    Args:
        linear: Likelihood of the delays.
    """
    profile = _Profile(linear)
    reach = np.linspace(math.log(SMALLEST_SPREAD), math.log(LARGEST_SPREAD), PLACES)
    costs = [profile.cost(x) for x in reach]
    best = int(np.argmin(costs))
    inner = reach[max(best - 1, 0)], reach[min(best + 1, PLACES - 1)]
    found: Any = minimize_scalar(profile.cost, bounds=inner, method="bounded", options={"xatol": 1e-9})
    ends = min((costs[best], reach[best]), (float(found.fun), float(found.x)))
    lowest, at = ends

    def above(x: float) -> float:
        return profile.cost(x) - lowest - DROP_95

    def end(x: float) -> float:
        return math.exp(root_scalar(above, bracket=sorted((at, x))).root)

    low = end(reach[0]) if above(reach[0]) > 0.0 else 0.0
    high = end(reach[-1]) if above(reach[-1]) > 0.0 else LARGEST_SPREAD
    mean, mean_sd = profile.mean(at)
    return NormalLaw(mean, math.exp(at), mean_sd, (low, high), 2.0 * (costs[0] - lowest))


class _Profile:
    """Profile likelihood of the spread: marginal likelihood at the best mean."""

    def __init__(self, linear: LinearDelays) -> None:
        values, ones, pulls = [], [], []
        for a, h in zip(linear.information, linear.pull, strict=True):
            value, vectors = np.linalg.eigh(a)
            values.append(value.clip(0.0))
            ones.append(vectors.sum(0))
            pulls.append(vectors.T @ h)
        self.values, self.ones, self.pulls = (np.concatenate(x) for x in (values, ones, pulls))

    def mean(self, log_spread: float) -> tuple[float, float]:
        """Best mean at a spread and its standard error [s]; 0 and infinity without information."""
        shrunk = 1.0 + math.exp(2.0 * log_spread) * self.values
        information = float(np.sum(self.values * self.ones**2 / shrunk))
        if information <= 0.0:
            return 0.0, math.inf
        return float(np.sum(self.ones * self.pulls / shrunk)) / information, information**-0.5

    def cost(self, log_spread: float) -> float:
        """Minus the log marginal likelihood, up to a constant."""
        square = math.exp(2.0 * log_spread)
        shrunk = 1.0 + square * self.values
        mean, _ = self.mean(log_spread)
        gain = mean * float(np.sum(self.ones * self.pulls / shrunk))
        gain -= 0.5 * mean**2 * float(np.sum(self.values * self.ones**2 / shrunk))
        gain += 0.5 * square * float(np.sum(self.pulls**2 / shrunk))
        return 0.5 * float(np.sum(np.log(shrunk))) - gain

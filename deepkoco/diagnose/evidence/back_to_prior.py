"""Another start for a fit that ended far from its prior.

Only products of a mass and a place, or ratios of loads and gains, show in a log. The sets of parameters that show the
same lie on a curved surface, and its distance from the values given has several minima. A fit that had to bend the
masses before a cause was found stays in the minimum where it was then.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.priors import prior_with, strained
from deepkoco.fit.fit import Fit, FitProblem, Trial

FAR = 1.0  # standard deviations of the prior from which a parameter starts again at its mean
WORTH = 1.0  # fall of the cost for which the other minimum is taken
PATIENCE = 40  # iterations


def back_to_prior(problem: FitProblem, start: Baseline, accepted: Sequence[Cause], fit: Fit) -> Fit:
    """Return a fit, or that of the same model from a start nearer to the prior if its cost is lower.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes of the fit.
        fit: The fit.
    """
    prior = prior_with(problem, start, accepted, fit.values)
    # A fit may also contain causes within their tolerance, which are not accepted.
    if not strained(problem, start, fit, not accepted) or not set(fit.free) <= set(prior.names):
        return fit
    sd = np.sqrt(start.prior.covariance.diagonal())
    means = {
        n: float(mean)
        for n, mean, s in zip(start.prior.names, start.prior.centre, sd, strict=True)
        if n in fit.free and abs(fit.values[n] - mean) >= FAR * s
    }
    values = {**fit.values, **means}
    state, _ = problem.fit_states(values, fit.state)
    other = problem.fit([Trial(fit.name, fit.free, prior, values, state, fit.nuisance)], PATIENCE)[0]
    return other if not other.diverged and other.cost < fit.cost - WORTH else fit

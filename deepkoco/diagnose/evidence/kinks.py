"""Parameters that a refit left at a kink, although the log does not tell their values.

The force limit of a servo acts only where it is reached. A fit that passes small limits on its way stops where the
limit meets the largest effort: to clip one sample more fits a little noise. There the log seems to tell the limit, for
by the slopes another value costs much. Beyond the kink it costs nothing. Whoever asks which of the values given are
wrong would count this limit beside the stiffness that is.
"""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.fit.fit import Fit, FitProblem, Trial

# Rise of chi2, deflated, for which a parameter is as it is given: chance lowers chi2 by one for each parameter.
WORTH = 2.0
PROMISED = 10.0  # the same by the slopes at the fit, which therefore do not hold that far
PATIENCE = 40  # iterations


def without_kinks(problem: FitProblem, start: Baseline, fit: Fit) -> Fit:
    """Return a fit, or one as good in which parameters are as given that the log does not tell.

    Args:
        problem: Training windows.
        start: The baseline, with the values given.
        fit: Refit of its parameters.

    Source: the likelihood ratio of one parameter, chi2 with one degree of freedom; its quadratic form holds at no kink.
    """
    deflation = dispersion(fit, problem.windows).deflation
    given = dict(zip(start.prior.names, start.prior.centre.tolist(), strict=True))
    away = np.array([fit.values[n] - given.get(n, fit.values[n]) for n in fit.free])
    promised = away**2 * fit.information.diagonal()
    names = [n for n, rise in zip(fit.free, promised, strict=True) if rise > PROMISED * deflation]
    if not names:
        return fit
    lanes = [fit.values, *({**fit.values, n: given[n]} for n in names)]
    theta = np.array([[lane[n] for n in problem.names] for lane in lanes])
    shown = problem.predict(theta, fit.state.repeat(len(lanes), 1, 1), fit.nuisance.repeat(len(lanes), 1))
    residual = fit.residual - problem.weighed(shown[1:] - shown[0])
    rise = (residual**2).flatten(1).sum(1).numpy() - float((fit.residual**2).sum())
    back = {n: given[n] for n, r in zip(names, rise, strict=True) if r <= WORTH * deflation}
    if not back:
        return fit
    trial = Trial(fit.name, fit.free, start.prior, {**fit.values, **back}, fit.state, fit.nuisance)
    other = problem.fit_one(trial, PATIENCE)
    return other if not other.diverged and other.cost <= fit.cost + WORTH * deflation else fit

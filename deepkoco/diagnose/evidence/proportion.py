"""The last fit once more, under a prior that counts as much as the residuals do.

Where a model error is left, the residuals count as few independent samples: likelihood ratios are divided by the
deflation. The cost of a fit counts all of them, so a friction of another shape than that of the catalogue moves a mass
that was weighed by four standard deviations. With the prior times the deflation D, the fit minimises chi2 / D plus the
prior, and its covariance times D is that of this posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline, tempered
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.data_sheet import guessed
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion

PATIENCE = 40  # iterations


def in_proportion(problem: FitProblem, start: Baseline, accepted: Sequence[Cause], fit: Fit) -> Fit:
    """Return the fit under a prior of the system's own parameters that counts as much as the residuals do.

    Fits that leave noise only stay as they are, and those under a prior that was tempered before: beside healthy logs,
    and of many parameters. A prior that is guessed from the kind of a parameter was measured by nobody, so it counts no
    more than it does. The prior of a cause is as wide as its size, so it does not count.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes of the fit.
        fit: The fit.
    """
    windows = problem.windows
    if start.healthy is not None or start.tempering > 1.0 or start.narrowing > 1.0 or guessed(start):
        return fit
    if not accepted or fit.chi2 / windows.samples <= start.most_noise(windows):
        return fit
    deflation = dispersion(fit, windows).deflation
    prior = prior_with(problem, replace(start, prior=tempered(start.prior, deflation)), accepted, fit.values)
    if not set(fit.free) <= set(prior.names):
        return fit  # it contains small effects that any unit has, under priors of their own
    found = problem.fit([Trial(fit.name, fit.free, prior, fit.values, fit.state, fit.nuisance)], PATIENCE)[0]
    if found.diverged:
        return fit
    return replace(found, penalty=found.penalty / deflation, narrowed=deflation)

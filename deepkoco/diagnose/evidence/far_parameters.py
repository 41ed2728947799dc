"""Parameters that a tempered refit moved far, as causes with evidence of their own.

Where a simulation is far from its log, the refit finds other sizes of its parameters before any cause is tried. What it
moved farther than any unit of the make can be is what the simulation gets wrong. Each of these parameters is tested: it
returns to the value given, all others are fitted anew, and the error must become clearly larger.

Source: likelihood-ratio test of one parameter, with the others as nuisances; Pawitan, In All Likelihood, ch. 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, catalogue
from deepkoco.diagnose.causes.parameter import CHANGED
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.evidence.selection import FURTHER
from deepkoco.fit.fit import Fit, Trial
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.prior import Prior

FAR = 2.0  # declared standard deviations beyond which the whole interval of a far parameter lies
ITERATIONS = 8  # of the fits without one of them; what is compared is large


def with_far_parameters(start: Baseline, found: Selected, causes: Sequence[Cause] | None = None) -> Selected:
    """Return a selection with the far parameters as causes before the others, the one with most evidence first.

    Args:
        start: The baseline, with a tempered prior.
        found: The causes that were selected on top of the refit.
        causes: Causes to try; None tries the whole catalogue.
    """
    problem, fit = found.acting, found.final
    spread = dispersion(fit, problem.windows)
    deflation = max(spread.deflation, start.least_deflation)
    named = {n for cause in found.accepted for n in cause.free}
    names = [n for n in far_names(start, fit, deflation) if n not in named]
    if causes is not None:
        asked = {c.name for c in causes}
        names = [n for n in names if _cause_of(n) in asked]
    if not names:
        return found
    prior = prior_with(problem, start, found.accepted, fit.values)
    fits = problem.fit([_at_given(start, prior, fit, n) for n in names], ITERATIONS)
    samples, known = problem.windows.samples / spread.correlation, catalogue(start.system.base)
    steps = []
    for name, less in zip(names, fits, strict=True):
        cause = known[_cause_of(name)]
        # A simulation that diverges with the value given speaks against it, but it has no size.
        ratio = 0.0 if less.diverged else max(less.cost - fit.cost, 0.0)
        score = ratio / deflation - penalty(cause, samples, 1)
        if score > FURTHER:
            ranking = Ranking(less, (Candidate(cause, fit, ratio, score),), spread, deflation, samples)
            steps.append((score, cause, ranking))
    steps.sort(key=lambda step: -step[0])
    return replace(
        found,
        accepted=(*(cause for _, cause, _ in steps), *found.accepted),
        steps=(*((ranking, (cause.name,)) for _, cause, ranking in steps), *found.steps),
    )


def far_names(start: Baseline, fit: Fit, deflation: float) -> list[str]:
    """Return the parameters of which the whole 95 % interval is far from the value given.

    A parameter of an effect that the refit frees, such as a delay of all commands, is far where it is not 0.

    Args:
        start: The baseline.
        fit: A fit of its parameters.
        deflation: Factor on the covariance of the fit.
    """
    found, freed = [], () if start.healthy is not None else start.effects
    for name in start.prior.names:
        effect = name.rpartition(".")[0]
        if name not in fit.free or (effect and effect not in freed):
            continue
        declared, i = start.system.parameter(name), fit.free.index(name)
        reach = 1.96 * float(np.sqrt(max(fit.covariance[i, i], 0.0) * deflation))
        usual = 0.0 if effect else FAR * declared.prior_sd
        if abs(fit.values[name] - start.values[name]) - reach > usual:
            found.append(name)
    return found


def _cause_of(name: str) -> str:
    """Name of the cause that a parameter belongs to."""
    return name.rpartition(".")[0] or f"{CHANGED.name}({name})"


def _at_given(start: Baseline, prior: Prior, fit: Fit, name: str) -> Trial:
    """Return a trial in which one parameter has its value as given, and all others are free."""
    keep = [i for i, n in enumerate(prior.names) if n != name]
    rest = replace(
        prior,
        names=tuple(prior.names[i] for i in keep),
        centre=prior.centre[keep],
        covariance=prior.covariance[np.ix_(keep, keep)],
    )
    values = {**fit.values, name: start.values[name]}
    return Trial(name, rest.names, rest, values, fit.state, fit.nuisance)

"""Which of several causes leads a class, where the simulation leaves errors that are correlated in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.evidence.around import around, trial_at
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty, with_better_fit
from deepkoco.diagnose.evidence.selection import PATIENCE
from deepkoco.diagnose.residuals.residuals import SLOTS
from deepkoco.fit.coloured import ColouredProblem, whitening
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion

NEARLY = 12.0  # BIC difference, with errors taken as independent, up to which a member can lead in the winner's place
CLEARLY = 6.0  # fall of the BIC under coloured errors from which another member leads ("strong evidence")
SLOW = 2.0  # samples per independent sample from which errors are correlated


def leader_under_colour(
    problem: FitProblem,
    start: Baseline,
    ranking: Ranking,
    members: Sequence[str],
    accepted: Sequence[Cause],
) -> Candidate | None:
    """Return the member of the winner's class that leads if its errors are taken as they are: correlated in time.

    The ranking counts one in so many samples of an error as independent. That is right for the size of its evidence,
    and blind for its content: a force that is missing is integrated twice, so errors of a position are slow, and the
    slow ones alone decide. Members of a class are therefore fitted once more to measurements and simulations that pass
    a filter, which makes what they leave together independent (:mod:`deepkoco.fit.coloured`). An offset and a gain that
    differs between directions have the same mean; they differ as the joint accelerates. On 18 generated logs with a
    force along the rail that no model has, offset or asymmetry was right by more than 12 in 11 and within 12 in 7: of
    these the errors as they are named 6, and independent ones 4 (with one fit of each member).

    Args:
        problem: The windows.
        start: The baseline.
        ranking: The ranking; its winner and the members are fitted to convergence.
        members: Names of the winner's class.
        accepted: Causes that are part of every fit.

    Returns:
        The leader, with a fit of lower cost where the fit under correlated errors is a better start of it. None where
        errors are not correlated. A member with more parameters than the winner never leads, nor does a changed
        parameter.
    """
    best = ranking.best
    rivals = [
        c
        for c in ranking.candidates[1:]
        if c.cause.name in members
        and c.fit is not ranking.reference
        and best.delta_bic - c.delta_bic < NEARLY
        and c.cause.free
        and c.cause.size <= best.cause.size
        and c.cause.effect != "event"
        and not is_changed(c.cause)
    ]
    if not rivals or ranking.dispersion.correlation < SLOW or best.cause.effect == "event":
        return None
    everyone = [best, *rivals]
    coloured = ColouredProblem(problem, whitening(problem, [c.fit for c in everyone]))
    if coloured.samples == 0:
        return None
    # Only minima are compared: the starts are minima under independent errors, and one may be nearer than another.
    found = [
        _minima(coloured, trial_at(problem, start, accepted, c), c.fit, ranking.deflation) for c in everyone
    ]
    if not found[0]:
        return None
    everyone, minima = zip(*((c, m) for c, m in zip(everyone, found, strict=True) if m), strict=True)
    fits = [min(own, key=lambda fit: fit.cost) for own in minima]
    lowest = min(fits, key=lambda fit: fit.cost)
    spread = dispersion(lowest, coloured.windows)
    places = SLOTS * len(problem.windows)
    scores = [
        -fit.cost / spread.deflation - penalty(c.cause, coloured.samples / spread.correlation, places)
        for c, fit in zip(everyone, fits, strict=True)
    ]
    first = max(range(len(everyone)), key=lambda k: scores[k])
    # Stick and slip leave a cost with many small minima. Which of them a fit finds hangs on the last bit of its start,
    # so a difference within their scatter tells nothing.
    scatter = max(float(np.median([fit.cost for fit in minima[k]])) - fits[k].cost for k in (0, first))
    leads = first if scores[first] > scores[0] + CLEARLY + scatter / spread.deflation else 0
    leader, there = everyone[leads], fits[leads]
    again = trial_at(problem, start, accepted, replace(leader, fit=there))
    return with_better_fit(leader, problem.fit([again], PATIENCE)[0], ranking.deflation)


def _minima(coloured: ColouredProblem, trial: Trial, fit: Fit, deflation: float) -> list[Fit]:
    """Fits under correlated errors from a start, and from starts as far off as its estimates are uncertain."""
    trials = around(coloured, trial, fit, deflation)
    return [found for found in coloured.fit(trials, PATIENCE) if not found.diverged]

"""Backward elimination: a cause that those found after it make superfluous is taken out again."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, kind_of
from deepkoco.diagnose.evidence.selection import CLOSE, ITERATIONS, penalty, prior_with
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial

BENDING = ("cogging", "periodic")  # lasting causes that bend to what they are not
PUSHES = ("event",)
FLEXIBLE_CAUSES = (*PUSHES, *BENDING)  # and all causes that do


def eliminated(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], fit: Fit, wanted: float, least: int = 1
) -> tuple[list[Cause], Fit]:
    """The causes that are still worth their parameters beside all others, and the fit of these.

    Forward selection may take a mixture of two causes for a third one; once both are found it has nothing left to
    explain.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes in the order in which they were found.
        fit: Fit with all of them.
        wanted: Fall of the BIC that keeps a cause.
        least: Number of causes that stay in any case.
    """
    kept = list(accepted)
    while len(kept) > least:
        fits = problem.fit([without(problem, start, kept, cause, fit) for cause in kept], ITERATIONS, CLOSE)
        spread = dispersion(fit, problem.windows)
        deflation = max(spread.deflation, start.least_deflation)
        samples, places = problem.windows.samples / spread.correlation, SLOTS * len(problem.windows)
        worth = [
            (less.cost - fit.cost) / deflation - penalty(cause, samples, places)
            for cause, less in zip(kept, fits, strict=True)
        ]
        weakest = worth.index(min(worth))
        if worth[weakest] > wanted:
            break
        del kept[weakest]
        fit = fits[weakest]
    return kept, fit


def carried(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], fit: Fit, held: Windows, least: int
) -> tuple[list[Cause], Fit]:
    """The causes that do no harm to windows which no fit saw, and the fit of these.

    What only imitates something else bends to the windows that are fitted. A push acts in none of the windows kept
    back, and stays.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes.
        fit: Fit with all of them.
        held: Windows kept back.
        least: Number of causes that stay in any case, pushes counted.
    """
    kept = list(accepted)

    def errors(found: Fit) -> np.ndarray:
        unseen = FitProblem(start.system, problem.elsewhere(held, found))
        replayed = unseen.evaluate({**found.values, "event.torque": 0.0}, "held back")
        return (replayed.residual**2).sum((1, 2)).numpy()

    while len(kept) > least and (lasting := [c for c in kept if c.effect != "event"]):
        fits = problem.fit(
            [without(problem, start, kept, cause, fit) for cause in lasting], ITERATIONS, CLOSE
        )
        now = errors(fit)
        # What only saves the baseline a way out of its prior does nothing for any window, and windows cannot judge it.
        harm = [
            np.zeros(len(held)) if less.diverged or _keeps_the_prior(less, fit) else now - errors(less)
            for less in fits
        ]
        worst = max(range(len(fits)), key=lambda k: float(harm[k].sum()))
        # What does nothing for these windows, as it acts in others, is no better or worse but for chance.
        if not harm[worst].sum() > np.sqrt(len(held)) * harm[worst].std():
            break
        kept.remove(lasting[worst])
        fit = fits[worst]
    return kept, fit


def _keeps_the_prior(less: Fit, fit: Fit) -> bool:
    """Whether what a fit with a cause saves is mostly a way of the baseline out of its prior."""
    saved = less.cost - fit.cost
    return saved > 0.0 and less.chi2 - fit.chi2 < 0.5 * saved


def without_kinds(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], fit: Fit, kinds: Collection[str]
) -> tuple[list[Cause], Fit]:
    """The other causes alone, where one of them bends to nothing: for residuals that are coloured even so.

    Detents, tones and pushes bend to any structure; what leaves some is no reason to believe in them.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes.
        fit: Fit with all of them.
        kinds: Which go.
    """
    kept = list(accepted)
    loose = [c for c in kept if kind_of(c.name) in kinds]
    if not loose or all(kind_of(c.name) in FLEXIBLE_CAUSES for c in kept):
        return kept, fit
    for cause in loose:
        fit = problem.fit_one(without(problem, start, kept, cause, fit), ITERATIONS, CLOSE)
        kept.remove(cause)
    return kept, fit


def without(problem: FitProblem, start: Baseline, kept: Sequence[Cause], cause: Cause, fit: Fit) -> Trial:
    """Fit of all causes but one, from where the fit of all of them is.

    Args:
        problem: The windows.
        start: The baseline.
        kept: All causes.
        cause: The one.
        fit: Fit with all of them.
    """
    others = [c for c in kept if c is not cause]
    values = dict(fit.values)
    if cause.effect == "event":
        values["event.torque"] = start.values["event.torque"]
    else:
        values |= {n: v for n, v in start.values.items() if n.startswith(f"{cause.effect}.")}
    prior = prior_with(problem, start, others, values)
    return Trial(cause.name, prior.names, prior, values, fit.state, fit.nuisance)

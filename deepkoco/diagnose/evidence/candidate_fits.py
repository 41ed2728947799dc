"""Fits of candidates: a few iterations of every start, then more for those that may become the winner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.evidence.footholds import CLOSE, ITERATIONS, SCOUTING
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes

SCOUTED = 0.7  # share of the whole fall of a cost that those iterations reach at least
PROMISING_SHARE = 0.3  # share of the best candidate's fall of the cost that a candidate needs by then
HALFWAY = 5  # further iterations, after which it needs HOPEFUL_SHARE
HOPEFUL_SHARE = 0.6  # share of the best candidate's fall of the cost
FRONT = 6  # candidates that are fitted with slopes of their own, where candidates share the slopes of their reference


def fit_best(
    problem: FitProblem,
    trials: Sequence[Trial],
    reference: Fit,
    known: FrozenSlopes | None = None,
    worth: float = 0.0,
) -> dict[str, Fit]:
    """Return the fit of each name: a few iterations of every trial, then more for the best trial of each name.

    Args:
        problem: Training windows.
        trials: The trials; several may have one name.
        reference: Fit whose cost they lower.
        known: Slopes near their starts, which the first iterations keep.
        worth: Fall of the cost that a cause needs; of those that fall short of it, only the best one is continued.
    """
    if not trials:
        return {}
    # Slopes hold as far around the starts as around the reference, near which these are.
    trials = [replace(trial, damping=max(trial.damping, reference.damping)) for trial in trials]
    scouts = problem.fit(trials, SCOUTING, CLOSE, known, exact=False, renewals=None if known is None else 0)
    best: dict[str, tuple[Fit, Trial]] = {}
    for trial, scout in zip(trials, scouts, strict=True):
        if trial.name not in best or scout.cost < best[trial.name][0].cost:
            best[trial.name] = (scout, trial)
    lowest = min(scout.cost for scout, _ in best.values())
    won = reference.cost - lowest
    longer, running = [], []
    for name, (scout, trial) in best.items():
        # A candidate that is far behind is not continued; it would not become the winner.
        fallen = reference.cost - scout.cost
        matters = fallen > SCOUTED * worth or scout.cost == lowest
        # With slopes of another point a fit also ends where these lead no further; that is no minimum of its own.
        going_on = known is not None or not scout.converged
        if going_on and fallen > PROMISING_SHARE * won and matters:
            running.append(name)
            longer.append((trial.from_fit(scout), scout))
    longer = (
        _fit_hopeful(problem, [trial for trial, _ in longer], reference)
        if known is None
        else _fit_front(problem, longer, known, reference)
    )
    return {name: scout for name, (scout, _) in best.items()} | dict(zip(running, longer, strict=True))


def _fit_hopeful(
    problem: FitProblem, trials: Sequence[Trial], reference: Fit, exact: bool = True
) -> list[Fit]:
    """Fit trials, halfway without those that are then so far behind the best that they would not be in its class.

    Args:
        problem: Training windows.
        trials: The trials.
        reference: Fit whose cost they lower.
        exact: Whether fits end with slopes at their own points.
    """
    fits = problem.fit(trials, HALFWAY, CLOSE, exact=exact)
    won = reference.cost - min((fit.cost for fit in fits), default=reference.cost)
    hopeful = [
        k
        for k, fit in enumerate(fits)
        if not (fit.converged or fit.diverged) and reference.cost - fit.cost > HOPEFUL_SHARE * won
    ]
    again = [trials[k].from_fit(fits[k]) for k in hopeful]
    for k, fit in zip(hopeful, problem.fit(again, ITERATIONS - HALFWAY, CLOSE, exact=exact), strict=True):
        fits[k] = fit
    return fits


def _fit_front(
    problem: FitProblem, scouted: Sequence[tuple[Trial, Fit]], known: FrozenSlopes, reference: Fit
) -> list[Fit]:
    """Fit trials with known slopes as far as these lead, then the best of them with slopes of their own.

    Of these, those that are far behind halfway are not fitted to the end.
    """
    trials, fits = [trial for trial, _ in scouted], [scout for _, scout in scouted]
    open_ones = [k for k, fit in enumerate(fits) if not fit.converged]
    found = problem.fit([trials[k] for k in open_ones], ITERATIONS, CLOSE, known, exact=False, renewals=0)
    for k, fit in zip(open_ones, found, strict=True):
        fits[k] = fit
    front = sorted(range(len(fits)), key=lambda k: fits[k].cost)[:FRONT]
    again = [trials[k].from_fit(fits[k]) for k in front]
    for k, fit in zip(front, _fit_hopeful(problem, again, reference, exact=False), strict=True):
        if fit.cost <= fits[k].cost:
            fits[k] = fit
    return fits

"""Backward elimination: a cause that those found after it make superfluous is taken out again."""

from __future__ import annotations

from collections.abc import Sequence

from deepkoco.diagnose.baseline import Start
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.residuals import SLOTS, dispersion
from deepkoco.diagnose.selection import CLOSE, ITERATIONS, penalty, prior_with
from deepkoco.identify.fit import Fit, FitProblem, Trial


def eliminated(
    problem: FitProblem, start: Start, accepted: Sequence[Cause], fit: Fit, wanted: float
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
    """
    kept = list(accepted)
    while len(kept) > 1:
        fits = problem.fit([_without(problem, start, kept, cause, fit) for cause in kept], ITERATIONS, CLOSE)
        spread = dispersion(fit, problem.windows)
        deflation = max(spread.deflation, start.floor)
        samples, places = problem.windows.samples / spread.correlation, SLOTS * len(problem.windows)
        worth = [
            (less.cost - fit.cost) / deflation - penalty(cause, samples, places)
            for cause, less in zip(kept, fits, strict=True)
        ]
        least = worth.index(min(worth))
        if worth[least] > wanted:
            break
        del kept[least]
        fit = fits[least]
    return kept, fit


def _without(problem: FitProblem, start: Start, kept: Sequence[Cause], cause: Cause, fit: Fit) -> Trial:
    others = [c for c in kept if c is not cause]
    values = dict(fit.values)
    if cause.effect == "event":
        values["event.torque"] = start.values["event.torque"]
    else:
        values |= {n: v for n, v in start.values.items() if n.startswith(f"{cause.effect}.")}
    prior = prior_with(problem, start, others, values)
    return Trial(cause.name, prior.names, prior, values, fit.state, fit.zero)

"""Candidates of the catalogue, ranked by the fall of the BIC."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.residuals.residuals import SLOTS, Dispersion, dispersion
from deepkoco.fit.fit import Fit, FitProblem


@dataclass(frozen=True)
class Candidate:
    """One cause, fitted together with the baseline's parameters.

    Attributes:
        cause: The cause.
        fit: Its fit; its cost is never above that of the reference.
        likelihood_ratio: Fall of the cost against the reference, under white noise.
        delta_bic: Fall of the BIC against the reference, after deflation.
    """

    cause: Cause
    fit: Fit
    likelihood_ratio: float
    delta_bic: float

    def only_promised(self, reference: Fit) -> bool:
        """Return whether the cause was not fitted, so that its score is what slopes promise."""
        return bool(self.cause.free) and self.fit is reference and self.likelihood_ratio > 0.0


def fitted_first(candidates: Iterable[Candidate], reference: Fit) -> tuple[Candidate, ...]:
    """Return candidates from best to worst; those that were not fitted are no better than the best that was."""
    found = list(candidates)
    best = max((c.delta_bic for c in found if not c.only_promised(reference)), default=0.0)
    capped = [
        replace(c, delta_bic=min(c.delta_bic, best)) if c.only_promised(reference) else c for c in found
    ]
    return tuple(sorted(capped, key=lambda c: (-c.delta_bic, c.only_promised(reference))))


@dataclass(frozen=True)
class Ranking:
    """Candidates from best to worst, with the reference and the deflation behind their scores.

    Attributes:
        reference: Fit of the baseline with the causes accepted so far.
        candidates: Best first.
        dispersion: Of the lowest fit.
        deflation: Factor on likelihood ratios.
        samples: Effective number of samples.
        unfitted: Causes for which the simulation diverges from every start.
        beside: Names of the causes that are part of the reference.
        asked: Names of all causes that might have competed.
    """

    reference: Fit
    candidates: tuple[Candidate, ...]
    dispersion: Dispersion
    deflation: float
    samples: float
    unfitted: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    asked: tuple[str, ...] = ()

    @property
    def best(self) -> Candidate:
        """The candidate whose BIC falls most."""
        return self.candidates[0]

    def compared(self, causes: Iterable[Cause], others: Iterable[Cause]) -> bool:
        """Return whether all these causes competed in it, beside exactly these others."""
        return {*self.beside} == {c.name for c in others} and {c.name for c in causes} <= {*self.asked}


def with_better_fit(candidate: Candidate, fit: Fit, deflation: float) -> Candidate:
    """Return a candidate with another fit of it, if that has the lower cost."""
    won = candidate.fit.cost - fit.cost
    if fit.diverged or won <= 0.0:
        return candidate
    return replace(
        candidate,
        fit=fit,
        likelihood_ratio=candidate.likelihood_ratio + won,
        delta_bic=candidate.delta_bic + won / deflation,
    )


def penalty(cause: Cause, samples: float, places: int) -> float:
    """Return the charge of the BIC for a cause that was searched for at ``places`` places."""
    charge = cause.size * math.log(max(samples, 2.0))
    # The places are charged twice: once because so many were tried, and once more because model error may spoil
    # any single window. A push can improve that window, and no other window can contradict it.
    charge += 2.0 * math.log(cause.choices)
    return charge + (4.0 * math.log(max(places, 1)) if cause.searched else 0.0)


def ranked(
    problem: FitProblem,
    start: Baseline,
    reference: Fit,
    tried: Sequence[Cause],
    fits: Mapping[str, Fit],
    promises: Mapping[str, float],
) -> Ranking:
    """Return the ranking of these causes on top of a reference.

    A cause that was not fitted is ranked with its promise, behind the best one that was: a promise is only what slopes
    tell.

    Args:
        problem: The windows.
        start: The baseline.
        reference: Fit without the causes.
        tried: The causes.
        fits: Cause -> its fit.
        promises: Cause -> largest fall of the cost by slopes; a cause that is in neither had no start values.
    """
    lowest = min([reference, *fits.values()], key=lambda fit: fit.cost)
    spread = dispersion(lowest, problem.windows)
    deflation = max(spread.deflation, start.least_deflation)
    samples = problem.windows.samples / spread.correlation
    places = SLOTS * len(problem.windows)
    candidates: list[Candidate] = []
    for cause in tried:
        if cause.name not in fits and cause.name not in promises:
            continue  # it had no start values
        fit = fits.get(cause.name, reference)
        ratio = reference.cost - fit.cost if cause.name in fits else promises.get(cause.name, 0.0)
        if ratio < 0.0:
            # If no start improves on the reference, the cause keeps its null value.
            fit, ratio = reference, 0.0
        score = ratio / deflation - penalty(cause, samples, places)
        candidates.append(Candidate(cause, fit, ratio, float(score)))
    return Ranking(reference, fitted_first(candidates, reference), spread, deflation, samples)

"""Candidates of the catalogue, ranked by the fall of the BIC."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.residuals.residuals import Dispersion
from deepkoco.fit.fit import Fit


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

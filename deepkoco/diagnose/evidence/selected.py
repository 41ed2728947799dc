"""The result of the selection of causes, and what it explains in terms of the BIC."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.diagnosis import Finding
from deepkoco.diagnose.evidence.minor import Minor
from deepkoco.diagnose.evidence.ranking import Ranking, penalty
from deepkoco.diagnose.evidence.residual_model import ResidualModel
from deepkoco.diagnose.residuals.residuals import (
    SLOTS,
    dispersion,
)
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem

Step = tuple[Ranking, tuple[str, ...]]


@dataclass(frozen=True)
class Selected:
    """Result of the selection.

    Attributes:
        final: Fit with all accepted causes and lost commands.
        accepted: Accepted causes of the catalogue.
        steps: For each accepted cause, the ranking that it won and the names of its class.
        acting: Training windows with the commands that acted; they differ from the sent ones where commands were lost.
        lost: Lost commands; None where none are accepted.
        charge: Charge of the BIC for the lost commands.
        minor: Significant causes that are not named, because there is too little of them.
        usual: Whether what is left is no more than any unit has, by the evidence.
        plain: What was selected without lost commands; None where none are accepted.
    """

    final: Fit
    accepted: tuple[Cause, ...]
    steps: tuple[Step, ...]
    acting: FitProblem
    lost: Finding | None = None
    charge: float = 0.0
    minor: tuple[Minor, ...] = ()
    usual: bool = False
    plain: Selected | None = None


def on_refit(steps: Sequence[Step]) -> Ranking | None:
    """Return the first ranking that was made on the refit alone, of the steps of a selection; None without one.

    Where causes of all joints were accepted at once, the first of them that is left may have been ranked beside others
    that were removed since. The reference of such a ranking is no refit of the simulation as given.
    """
    return next((ranking for ranking, _ in steps if not ranking.beside), None)


def fall_of_bic(found: Selected, reference: Fit, lowest: Fit, start: Baseline, train: Windows) -> float:
    """Return the fall of the BIC from the refit to a selection.

    Args:
        found: The selection.
        reference: The refit.
        lowest: Fit whose residuals give the deflation.
        start: The baseline.
        train: The windows.
    """
    spread = dispersion(lowest, train)
    samples, places = train.samples / spread.correlation, SLOTS * len(train)
    charge = found.charge + sum(penalty(cause, samples, places) for cause in found.accepted)
    return (reference.cost - found.final.cost) / max(spread.deflation, start.least_deflation) - charge


def learned_instead(
    found: Selected, reference: Fit, learned: ResidualModel, start: Baseline, train: Windows, least: float
) -> bool:
    """Return whether a learned load explains the data better than the selected causes, by a given fall of the BIC.

    If the selected causes are correct, the learned load has no residual left to fit. Detents, tones and pushes
    together can imitate the smooth load of a missing mechanism; a learned load cannot imitate them.

    Args:
        found: The selection.
        reference: The refit.
        learned: Load learned on top of the refit.
        start: The baseline.
        train: The windows.
        least: Fall of the BIC by which the learned load must be ahead; negative if it may be behind by that much.
    """
    if not learned.accepted:
        return False
    lowest = min(found.final, learned.fit, key=lambda fit: fit.cost)
    spread = dispersion(lowest, train)
    charge = len(learned.terms) * math.log(train.samples / spread.correlation)
    won = (reference.cost - learned.fit.cost) / max(spread.deflation, start.least_deflation) - charge
    return won > fall_of_bic(found, reference, lowest, start, train) + least

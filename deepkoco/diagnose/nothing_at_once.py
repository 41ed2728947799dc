"""A healthy unit of a model file: weights say "nothing" before any cause is selected, and the selection is left out.

The selection takes most of the time of a diagnosis: it compares what is alike, fits classes from many starts and tries
further causes beside those that it has accepted. Most of it is about names. Explanations are weighed on the refit
alone (:mod:`deepkoco.diagnose.weighed`), so they can be weighed first. Where "nothing" weighs most, what was selected
is given up afterwards: it stays in the fit, and no name follows. Then the fit alone is wanted. It takes in a little of
every small effect at once, or the best cause of each ranking, whatever is alike, and holds if it leaves no more than a
healthy unit does.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.data_sheet import guessed
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.explanation import Begun, Explanation, of_mean
from deepkoco.diagnose.little_of_all import refit_with_little
from deepkoco.diagnose.probability.answer import Answer
from deepkoco.diagnose.probability.shadow import (
    Weighing,
    answer_of,
    log_prior_of_losses,
    of_rough_sheet,
    weighing_of,
)
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.scaled_inverse import DivergedError

PLAUSIBLE = math.log(100.0)  # nats behind the best from which an explanation's causes are not tried again
FAR_ABOVE = 2.0  # chi2 per sample, in floors, of a fit that does not explain a log to its noise
ROUGH = math.log(0.1 / 0.9)  # log prior odds that a data sheet is rough


@dataclass(frozen=True)
class Weights:
    """Weights of explanations on one refit.

    Attributes:
        base: The refitted baseline.
        answer: The weights.
        weighing: The explanations that they compare.
    """

    base: Refitted
    answer: Answer
    weighing: Weighing
    _rough: list[float] = field(default_factory=list)

    @staticmethod
    def of(request: DiagnosisRequest, base: Refitted, named: Collection[str] = ()) -> Weights:
        """Weigh the explanations on a refit.

        Args:
            request: The logs.
            base: The refit.
            named: Causes that were selected, see `answer_of`.

        Raises:
            DivergedError: The simulation diverges.
            LinAlgError: The logs tell nothing of a parameter.
        """
        found = weighing_of(request, base)
        return Weights(base, found.answer(named), found)

    def beside(self, named: Collection[str]) -> Weights:
        """Return the weights beside causes that were selected, see `answer_of`."""
        return replace(self, answer=self.weighing.answer(named))

    def hold(self, base: Refitted) -> bool:
        """Return whether these are the weights on this refit, too."""
        if base.learned.healthy is not None:
            # What healthy logs say does not depend on the refit.
            return base.learned.healthy is self.base.learned.healthy
        own = self.base
        return base.reference is own.reference and base.train is own.train and base.start is own.start

    def rough(self, causes: Sequence[Cause]) -> float:
        """Return the log weight of a rough data sheet; none is asked for with healthy logs.

        Args:
            causes: The catalogue.

        Raises:
            DivergedError: No refit stays finite.
        """
        base = self.base
        if base.learned.healthy is not None:
            return -math.inf
        if not self._rough:
            self._rough.append(of_rough_sheet(base.problem, base.reference, base.start, causes) + ROUGH)
        return self._rough[0]


def alike_in(ranking: Ranking) -> set[str]:
    """Return the best cause of a ranking and those that hardly explain less."""
    return {c.cause.name for c in ranking.candidates if ranking.best.delta_bic - c.delta_bic < APART}


class Losses(NamedTuple):
    """Weights of explanations under the commands that acted.

    Attributes:
        answer: The weights.
        log_prior: Log prior of the pattern of lost commands.
    """

    answer: Answer
    log_prior: float

    @property
    def top(self) -> float:
        """The largest log weight, with that of the pattern."""
        return self.answer.explanations[0].log_weight + self.log_prior

    def outweigh(self, answer: Answer) -> bool:
        """Return whether they weigh more than what explains the commands that were sent."""
        return self.top > answer.explanations[0].log_weight


def losses_of(request: DiagnosisRequest, base: Refitted, found: Selected) -> Losses:
    """Weigh explanations under the commands that acted, for a selection with lost commands.

    Args:
        request: The logs.
        base: The refit on which explanations are weighed without them.
        found: The selection.

    Raises:
        DivergedError: The simulation diverges.
        LinAlgError: The logs tell nothing of a parameter.
    """
    answer = answer_of(request, base, found.acting.windows)
    return Losses(answer, log_prior_of_losses(found.charge, len(request.causes)))


def are_weighed(base: Refitted) -> bool:
    """Return whether explanations are weighed: for units of a model file with few parameters."""
    many = len(base.reference.free) + base.train.state.shape[1] >= MANY
    return not many and base.start.tempering == 1.0 and guessed(base.start)


def weights_before(request: DiagnosisRequest, at: Begun) -> Weights | None:
    """Return the weights on a refit before its causes are selected, where a selection would begin; else None.

    Args:
        request: The logs.
        at: The first ranking.
    """
    ranking = at.first.ranking
    begins = bool(ranking.candidates) and ranking.best.delta_bic > request.detection
    if not begins or not are_weighed(at.base) or not request.limit.allows("weighing the data sheet"):
        return None
    request.progress("weighing the data sheet")
    try:
        return Weights.of(request, at.base)
    except (DivergedError, np.linalg.LinAlgError):
        return None


def nothing_at_once(
    request: DiagnosisRequest,
    at: Begun,
    weights: Weights,
    unfitted: Sequence[str] = (),
    joined: tuple[str, ...] = (),
) -> Explanation | None:
    """Return an explanation for which no name is looked for, if none can be found; else None.

    That needs all of these: "nothing" weighs most, and more than a rough data sheet does; a little of every small
    effect, or the causes that are taken into the fit for their size alone, leave no more than a healthy unit does; and
    no pattern of lost commands explains enough beside them.

    Args:
        request: The logs, and the causes to try.
        at: The first ranking.
        weights: Weights on the same refit.
        unfitted: What could not be fitted so far, in words.
        joined: Names of causes that joined the baseline before.
    """
    base, best = at.base, weights.answer.explanations[0]
    try:
        if best.causes or weights.rough(request.causes) > best.log_weight:
            return None
    except (DivergedError, np.linalg.LinAlgError):
        return None
    first = at.first
    little = _refit_with_little(request, base)
    if little is not None:
        first = _selection(request, little).first_ranking(
            little.reference, missing_torque(little.problem, little.reference)
        )
        base = replace(little, reference=first.ranking.reference)
    ranking, found = _selection(request, base).go_on(first)
    if found.lost is not None and found.plain is not None:
        if not request.limit.allows("weighing the lost commands"):
            return None
        request.progress("weighing the lost commands")
        try:
            if losses_of(request, at.base, found).outweigh(weights.answer):
                return None
        except (DivergedError, np.linalg.LinAlgError):
            return None
        found = found.plain
    if little is None and more_than_noise(found.final, base.train, base.start) is not None:
        return None
    # A cause that is selected is weighed in any case, and so is what is alike.
    alike = {n for step in (at.first.ranking, *(own for own, _ in found.steps)) for n in alike_in(step)}
    try:
        weights = weights.beside(alike)
    except (DivergedError, np.linalg.LinAlgError):
        return None
    if weights.answer.explanations[0].causes:
        return None
    words = (*unfitted, *ranking.unfitted)
    return of_mean(Explanation(base, ranking, found, joined, words, weights.answer))


def _refit_with_little(request: DiagnosisRequest, base: Refitted) -> Refitted | None:
    """Return the refit with a little of every small effect, where it leaves no more than any unit does; else None.

    A selection takes such effects one by one, and ranks the whole catalogue beside each.
    """
    if not request.limit.allows("small effects that any unit has"):
        return None
    request.progress("small effects that any unit has")
    little = refit_with_little(base, base.reference, request.causes)
    if little is None or is_far_above(little.reference, little):
        return None
    return little


def is_far_above(fit: Fit, base: Refitted) -> bool:
    """Return whether a fit leaves so much more than noise that the log cannot be that of a healthy unit."""
    return fit.chi2 > FAR_ABOVE * base.start.floor * base.train.samples


def _selection(request: DiagnosisRequest, base: Refitted) -> Selection:
    """Return a selection on a refit that wants the fit alone, and no name."""
    quick = Selection(
        base.start, base.train, base.held, request.causes, request.detection, request.progress, request.limit
    )
    quick.naming = False
    return quick

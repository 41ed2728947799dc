"""The family of a cause that is not in the catalogue: friction of another shape, a drive that lags in another way.

Where nothing explains enough to be named, the catalogue may still show where to look. Friction that
creeps and ages is no Coulomb friction and no bristle, but both explain most of what it does, and no delay comes near.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.causes.parameter import FAMILY as PARAMETER
from deepkoco.diagnose.evidence.classes import width
from deepkoco.diagnose.evidence.how_probable import NOTHING, UNKNOWN, how_probable
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.verdict.outweighed import MOST_DOUBTED
from deepkoco.diagnose.verdict.unknown import explained_share

MOST_OF = 0.6  # share of the difference that the best cause of the family explains
SURE = 0.9  # probability of the family among all causes
WORDS = {  # families in which something else of the same kind makes sense
    "friction": "friction of a shape",
    "timing": "a delay or a lag of a kind",
    "actuator": "an actuator that differs in a way",
    "drive": "a drive that gives in a way",
    "disturbance": "a load of a shape",
    "sensor": "a sensor that differs in a way",
    "body": "a body that differs in a way",
}


class Family(NamedTuple):
    """Where an unknown cause most likely is.

    Attributes:
        name: The family.
        cause: Its cause that explains most.
        share: Share of the difference that this cause explains.
        probability: Of the family among all causes of the catalogue.
    """

    name: str
    cause: str
    share: float
    probability: float

    @property
    def text(self) -> str:
        """The family as the end of a sentence."""
        return f"{WORDS[self.name]} that is not in the catalogue"

    def to_json(self) -> dict[str, Any]:
        """Return the fields and the text for ``report.json``."""
        return {**self._asdict(), "text": self.text}


def family_of(explanation: Explanation) -> Family | None:
    """Return the family of what the logs show; None where causes of several families come as near.

    Another value of a parameter is no rival: almost every mechanism can also be written so. Where explanations were
    weighed, the log must be more probable with a cause of the family than without any: the selection has no smooth load
    as a rival, and the family of a wrong cause is no better than its name.

    Args:
        explanation: The refitted baseline and the ranking of the whole catalogue.
    """
    base, first = explanation.base, explanation.first
    rivals = [c for c in first.candidates if _family(c.cause.name) != PARAMETER]
    if not rivals or rivals[0].delta_bic <= 0.0:
        return None
    best = rivals[0]
    family = best.cause.family
    share = explained_share(base.reference, best.fit, base.train, base.start.floor)
    if family not in WORDS or share < MOST_OF:
        return None
    chances = how_probable(rivals, 0.0, width(base.problem, base.start, first))
    named = {n: p for n, p in chances.items() if n not in (NOTHING, UNKNOWN)}
    own = sum(p for n, p in named.items() if _family(n) == family)
    probability = own / sum(named.values())
    if explanation.weights is not None:
        members = [n for n in explanation.weights.causes if n != UNKNOWN and _family(n) == family]
        if explanation.weights.of_any(members) <= MOST_DOUBTED:
            return None
    return Family(family, best.cause.name, share, probability) if probability >= SURE else None


def _family(name: str) -> str:
    return CAUSES[kind_of(name)].family

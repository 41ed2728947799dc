"""How probable each candidate is in its place: against its rivals, against nothing, and against what nobody listed.

A score is the fall of the BIC, less the fall that a name needs. Its half is a log weight; "nothing" has the log
weight 0, so a cause at the threshold is as probable as nothing. Where a model error is left, differences of the BIC
vary more than under noise (:func:`deepkoco.diagnose.evidence.classes.width`), and count less by as much.

Source of the weights: Kass and Raftery, Bayes factors, JASA 90 (1995), with the BIC for minus twice the log evidence.
What the numbers are worth is measured by `experiments.studies.diagnosis.reliability`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.ranking import Candidate

NOTHING, UNKNOWN = "nothing", "unknown"
OUTSIDE = (
    0.05  # prior probability of a cause that is not in the catalogue, as in `deepkoco.diagnose.probability`
)
LISTED = 0.01  # probability from which something is listed


def how_probable(
    candidates: Sequence[Candidate], wanted: float, wide: float = APART, members: Collection[str] = ()
) -> dict[str, float]:
    """Return the probability of each candidate, of "nothing" and of "unknown"; they add up to 1.

    Args:
        candidates: The candidates; where there are members of a class, its leader first.
        wanted: Fall of the BIC that a name needs in this place.
        wide: Difference of the BIC from which two causes are distinguished.
        members: Class of the leader. It leads by what is known beside this log, so no member is more probable.
    """
    lead = candidates[0].delta_bic if candidates and members else np.inf
    capped = [min(c.delta_bic, lead) if c.cause.name in members else c.delta_bic for c in candidates]
    return _shared(dict(zip((c.cause.name for c in candidates), capped, strict=True)), wanted, wide)


def alone(name: str, delta_bic: float, wanted: float) -> dict[str, float]:
    """Return the probability of a cause without rivals, of "nothing" and of "unknown".

    Args:
        name: The cause.
        delta_bic: Fall of the BIC with it.
        wanted: Fall that a name needs.
    """
    return _shared({name: delta_bic}, wanted, APART)


def listed(chances: Mapping[str, float]) -> dict[str, float]:
    """Return what is probable enough to be listed, the most probable first and "unknown" last.

    Args:
        chances: Probabilities by name.
    """
    worth = sorted((n for n, p in chances.items() if p >= LISTED), key=lambda n: (n == UNKNOWN, -chances[n]))
    return {n: chances[n] for n in worth}


def _shared(delta_bic: Mapping[str, float], wanted: float, wide: float) -> dict[str, float]:
    scores = np.array([0.0, *((s - wanted) * APART / wide for s in delta_bic.values())])
    weight = np.exp(0.5 * (scores - scores.max()))
    share = (1.0 - OUTSIDE) * weight / weight.sum()
    return {
        NOTHING: float(share[0]),
        **dict(zip(delta_bic, share[1:].tolist(), strict=True)),
        UNKNOWN: OUTSIDE,
    }

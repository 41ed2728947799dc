"""Which starts of which causes are worth a fit, by what the score test promises."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.ranking import Ranking, penalty
from deepkoco.diagnose.evidence.screening import WORTH, StartPoint

MIN_OF_BEST_CAUSE = 0.2  # share of the largest promise of all causes from which a cause is fitted
MIN_OF_BEST_START = 0.3  # share of a cause's largest promise that its further starts need
STARTS = 3  # largest number of starts of one cause
MARGIN = 2.0  # fall of the cost that a fit may reach, over the one that slopes promise
ROUNDS = 3  # in which causes are fitted that promise more than the fits before have reached
SEARCHED = 10  # the same of a cause that is searched in time
# With many parameters, causes of each joint (and as many without a joint) that are fitted: a cause at a joint shows
# mostly in the motion of that joint, and the score test orders those of one joint well.
PER_PLACE = 4
FRICTION = "friction"  # family


def largest_promises(promises: Sequence[StartPoint]) -> dict[str, float]:
    """Largest promise of each cause."""
    result: dict[str, float] = {}
    for p in promises:
        result[p.cause.name] = max(result.get(p.cause.name, 0.0), p.promise)
    return result


def promising_starts(promises: Sequence[StartPoint]) -> list[StartPoint]:
    """Return the starts that are fitted: the best ones of each cause whose promise is large enough, more of a push.

    A push is tried at several times, each of which may lead to a minimum of its own. Only a fit tells which one: a push
    that explains one window promises more than the longer one, a little too early, that explains three.
    """
    best = largest_promises(promises)
    bar = max(WORTH, MIN_OF_BEST_CAUSE * max(best.values(), default=0.0))
    kept: dict[str, list[StartPoint]] = {}
    for p in sorted(promises, key=lambda p: -p.promise):
        own = kept.setdefault(p.cause.name, [])
        worth, most = MIN_OF_BEST_START * best[p.cause.name], STARTS
        if p.cause.searched:
            worth, most = WORTH, SEARCHED
        if best[p.cause.name] >= bar and p.promise >= worth and len(own) < most:
            own.append(p)
    return [p for own in kept.values() for p in own]


def outstanding(
    ranking: Ranking, promises: Sequence[StartPoint], asked: Collection[str], places: int, wanted: float
) -> list[StartPoint]:
    """Return the best starts of causes that were not fitted although they promise more than any fit has reached.

    Which causes are fitted first is decided by what the others promise. A promise is what slopes tell, and a cause that
    promises most may gain little: the others then have to be asked.

    Args:
        ranking: Ranking of what was fitted; the others have their promise.
        promises: Starts of all causes.
        asked: Names of the causes that were fitted, or from which a simulation diverged.
        places: Places in time at which a push was searched for.
        wanted: Fall of the BIC from which a cause is named.
    """
    fitted = [c for c in ranking.candidates if c.cause.name in asked]
    least = max(max((c.delta_bic for c in fitted), default=0.0) - APART, wanted)
    ranked = {c.cause.name for c in ranking.candidates}
    found: dict[str, StartPoint] = {}
    for p in sorted(promises, key=lambda p: -p.promise):
        name = p.cause.name
        if name in asked or name in found or name not in ranked:
            continue
        score = p.promise / ranking.deflation - penalty(p.cause, ranking.samples, places)
        if p.promise >= WORTH and score > least:
            found[name] = p
    return list(found.values())


def best_of_each_place(points: Sequence[StartPoint], charge: Mapping[str, float]) -> list[StartPoint]:
    """Return the starts of the causes that promise most at each joint, and of those that have none.

    Args:
        points: Starts.
        charge: Cause -> fall of the cost that it needs for its parameters.
    """
    joints = {p.cause.name: p.cause.joint for p in points}
    promised = {n: promise - charge[n] for n, promise in largest_promises(points).items()}
    kept: dict[int | None, set[str]] = {}
    for name in sorted(promised, key=lambda n: -promised[n]):
        own = kept.setdefault(joints[name], set())
        if len(own) < PER_PLACE:
            own.add(name)
    names = set().union(*kept.values())
    return [p for p in points if p.cause.name in names]


def simpler_frictions(
    found: Ranking, promises: Sequence[StartPoint], asked: Collection[str]
) -> list[StartPoint]:
    """Return frictions of the joint of the best cause with fewer parameters, where that is a friction, too.

    A friction that falls with the speed has one that does not as a special case. How much that would explain is taken
    from its slope where there is none of it, which tells little of a joint that stops.

    Args:
        found: The ranking.
        promises: Starts of causes.
        asked: Names of the causes that have been fitted.
    """
    if not found.candidates or found.best.cause.family != FRICTION:
        return []
    best = found.best.cause
    return [
        p
        for p in promises
        if p.cause.family == FRICTION
        and p.cause.joint == best.joint
        and len(p.cause.free) < len(best.free)
        and p.cause.name not in asked
    ]


def within_reach(points: Sequence[StartPoint], charge: Mapping[str, float], least: float) -> list[StartPoint]:
    """Return starts whose causes could be named if a fit reached some times what slopes promise.

    A cause that is searched in time gains by another time, which no slope tells, so its starts stay.

    Args:
        points: Starts.
        charge: Cause -> fall of the cost that it needs for its parameters.
        least: Fall of the cost beyond that from which a cause is named.
    """
    return [p for p in points if p.cause.searched or MARGIN * p.promise - charge[p.cause.name] > least]

"""Which starts of which causes are worth a fit, by what the score test promises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deepkoco.diagnose.evidence.screening import WORTH, StartPoint

MIN_OF_BEST_CAUSE = 0.2  # share of the largest promise of all causes from which a cause is fitted
MIN_OF_BEST_START = 0.3  # share of a cause's largest promise that its further starts need
STARTS = 3  # largest number of starts of one cause
SEARCHED = 10  # the same of a cause that is searched in time
# With many parameters, causes of each joint (and as many without a joint) that are fitted: a cause at a joint shows
# mostly in the motion of that joint, and the score test orders those of one joint well.
PER_PLACE = 4


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

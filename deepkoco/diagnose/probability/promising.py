"""Which of the explanations that were scored at a point of linearisation are refitted."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from deepkoco.diagnose.probability.answer import Answer, Weighed
from deepkoco.diagnose.probability.search import Scored

REFITTED = 20  # explanations that are refitted at each point of linearisation
BEHIND = 12.0  # nats behind the best from which an explanation is not refitted
RIVALS = 8  # single causes that are refitted beside those


def promising(scored: Sequence[Scored]) -> list[Scored]:
    """Return the explanations to refit: the best ones, and nothing and unknown in any case."""
    best = scored[0].log_weight
    chosen: dict[tuple[str, ...], Scored] = {}
    for s in scored:
        always = not s.explanation.items
        if always or (s.log_weight > best - BEHIND and len(chosen) < REFITTED):
            chosen.setdefault(s.explanation.causes, s)
    return list(chosen.values())


def as_promising(
    scored: Sequence[Scored], refitted: Sequence[Scored], found: Sequence[Weighed]
) -> list[Scored]:
    """Return single causes that are behind by less than the scores at a point of linearisation are wrong.

    A score is wrong by what a refit adds to it. Far from the point where a simulation is linear, that is a hundred nats
    between causes that do nearly the same, such as a delay and a filter.
    """
    score = {s.explanation.causes: s.log_weight for s in reversed(refitted)}
    wrong = max((e.log_weight - score[e.causes] for e in found if e.causes in score), default=0.0)
    chosen: dict[tuple[str, ...], Scored] = {}
    for s in scored:
        single = len(s.explanation.items) == 1 and not s.explanation.unknown
        near = s.log_weight > scored[0].log_weight - BEHIND - max(wrong, 0.0)
        if single and near and s.explanation.causes not in score and len(chosen) < RIVALS:
            chosen.setdefault(s.explanation.causes, s)
    return list(chosen.values())


def doubted(scored: Sequence[Scored], named: Collection[str], found: Sequence[Weighed]) -> list[Scored]:
    """Return named causes alone and beside an unknown one, from their best starts, if others are more probable so far.

    A linearised score may be wrong by all that a cause explains, so they have to be refitted before they are doubted.
    """
    if not named or not found or Answer.of(found, 0, 0.0).of_any(named) > 0.5:
        return []
    known = {e.causes for e in found}
    chosen: dict[tuple[str, ...], Scored] = {}
    for s in scored:
        single = len(s.explanation.items) == 1 and s.explanation.items[0].cause.name in named
        if single and s.explanation.causes not in known:
            chosen.setdefault(s.explanation.causes, s)
    return list(chosen.values())

"""All sets of up to three causes on one linearisation."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deepkoco.diagnose.probability.coordinates import Item
from deepkoco.diagnose.probability.explanations import Explanation, log_prior, sets_of
from deepkoco.diagnose.probability.linear import NEGLIGIBLE, Linearisation, log_sum

POINTS = 2  # pairs of amplitudes at which sets of several causes are compared
SINGLES = 40  # causes of which all triples are formed
CHUNK = 20_000  # sets in one batch


@dataclass(frozen=True)
class Scored:
    """An explanation with its log of prior times evidence.

    Attributes:
        explanation: The explanation.
        log_weight: Log prior plus log evidence.
        amplitude: Number of the pair of amplitudes that contributes most.
        mode: Values of its changes there, in the order of its columns.
    """

    explanation: Explanation
    log_weight: float
    amplitude: int
    mode: np.ndarray


def search(
    linear: Linearisation, items: Sequence[Item], causes: int, left_out: Callable[[Scored], bool]
) -> list[Scored]:
    """Score nothing, unknown, every single cause and all sets of up to three, best first.

    Args:
        linear: The likelihood.
        items: Causes from each of their starts.
        causes: Number of causes of the catalogue.
        left_out: Whether an explanation is none. A cause that is none alone is in no set.
    """
    amplitudes = linear.unit.amplitudes
    top = np.maximum(amplitudes.log_healthy, amplitudes.log_unknown)
    keep = top > top.max() + NEGLIGIBLE
    changes = linear.at_all(keep)
    nothing = np.array([-np.inf if c is None else c.log_nothing for c in changes])
    healthy, unknown = nothing + amplitudes.log_healthy, nothing + amplitudes.log_unknown
    found = [
        _scored(Explanation(), healthy, causes),
        _scored(Explanation(unknown=True), unknown, causes),
    ]
    if not items:
        return sorted(found, key=lambda s: -s.log_weight)
    # Single causes, alone and beside an unknown model error.
    alone = [Explanation((item,)) for item in items]
    sets = np.array(sets_of(alone))
    gains, modes = np.full((len(changes), len(items)), -np.inf), np.zeros((len(changes), *sets.shape))
    for a, own in enumerate(changes):
        if own is not None:
            freed = linear.freed(own, sets)
            gains[a], modes[a] = _sound(freed.log_gain), freed.mode
    sound = []
    for k, item in enumerate(items):
        own = _scored(Explanation((item,)), healthy + gains[:, k], causes, modes[:, k])
        if not left_out(own):
            sound.append(k)
            found += [own, _scored(Explanation((item,), True), unknown + gains[:, k], causes, modes[:, k])]
    items, gains = [items[k] for k in sound], gains[:, sound]
    if not items:
        return sorted(found, key=lambda s: -s.log_weight)
    # Several causes, at the sizes of the model error that nothing and the best single cause ask for.
    weight = log_sum(healthy[:, None] + gains, axis=0)
    best = int(weight.argmax())
    points = list(dict.fromkeys([int((healthy + gains[:, best]).argmax()), int(healthy.argmax())]))[:POINTS]
    first = _best_start(items, weight)
    pairs = [Explanation(p) for p in itertools.combinations(items, 2) if _compatible(p)]
    triples = [Explanation(t) for t in itertools.combinations(first[:SINGLES], 3) if _compatible(t)]
    for group in (pairs, triples):
        several = _several(linear, changes, group, healthy, points, causes)
        found += [one for one in several if not left_out(one)]
    return sorted(found, key=lambda s: -s.log_weight)


def _compatible(items: Sequence[Item]) -> bool:
    """Return whether all causes differ, and at most one is a push: a simulation has one."""
    return len({i.cause.name for i in items}) == len(items) and sum(i.cause.searched for i in items) <= 1


def _several(linear, changes, group, healthy, points, causes) -> list[Scored]:
    """Score sets at a few amplitudes; the best ones only are kept."""
    found = []
    for at in range(0, len(group), CHUNK):
        part = group[at : at + CHUNK]
        sets = np.array(sets_of(part))
        priors = np.array([log_prior(e, causes) for e in part])
        freed = [linear.freed(changes[a], sets) for a in points]
        scores = np.stack([healthy[a] + _sound(f.log_gain) for a, f in zip(points, freed, strict=True)])
        weight = log_sum(scores) + priors
        for k in np.argsort(-weight)[:200]:
            a = int(scores[:, k].argmax())
            mode = freed[a].mode[k][: len(part[k].columns)]
            found.append(Scored(part[k], float(weight[k]), points[a], mode))
    return found


def _sound(gain: np.ndarray) -> np.ndarray:
    """A gain that overflows, far from where a simulation is linear, says nothing for a cause."""
    return np.where(np.isfinite(gain), gain, -np.inf)


def _scored(
    explanation: Explanation, scores: np.ndarray, causes: int, modes: np.ndarray | None = None
) -> Scored:
    """Score nothing or one cause by its scores (A,) and modes (A, k) at all amplitudes."""
    a = int(scores.argmax())
    mode = np.zeros(0) if modes is None else modes[a, : len(explanation.columns)]
    return Scored(explanation, float(log_sum(scores)) + log_prior(explanation, causes), a, mode)


def _best_start(items: Sequence[Item], weight: np.ndarray) -> list[Item]:
    """Return each cause from its best start, the best causes first."""
    found: dict[str, Item] = {}
    for k in np.argsort(-weight):
        found.setdefault(items[k].cause.name, items[k])
    return list(found.values())

"""Assign the joints of a log to those of a model by name and order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import SequenceMatcher
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

SAME = 8.0  # evidence of the same name [nats]
ITS_OWN = 6.0  # evidence of a word or a number that one joint has alone [nats]
WORD = 5.0  # evidence of the same words, in proportion to their share [nats]
ORDER = 1.5  # evidence of the same place in the order, if there are as many joints [nats]
FEWER = 0.75  # times that of the number of a joint, if there are fewer
SAME_NAME, ITS_WORD = "the same name", "is in the name"  # of reasons
NOTHING = 0.5  # evidence of a joint without a partner [nats]
_ALIKE = (
    {"pan", "rotation", "yaw", "base", "waist", "swivel", "turn", "abduction", "haa"},
    {"lift", "pitch", "flex", "tilt", "flexion"},
    {"roll", "twist", "rotate"},
    {"gripper", "jaw", "claw", "finger", "hand"},
    {"elbow", "forearm", "knee", "kfe"},
    {"shoulder", "upper", "hip"},
    {"left", "l"},
    {"right", "r"},
    {"front", "fore", "f"},
    {"rear", "hind", "back", "h"},
)


_ALONG = (
    {"base", "waist", "pan", "yaw"},
    {"shoulder", "hip"},
    {"elbow", "knee", "forearm"},
    {"wrist", "ankle"},
    {"gripper", "jaw", "hand", "tool", "foot"},
)
"""Words in the order of joints from the base outwards."""


class Match(NamedTuple):
    """One pair of joints, by their numbers, with probability and reason."""

    log: int
    model: int
    probability: float
    reason: str


def match_joints(
    log: Sequence[str], model: Sequence[str], apart: Sequence[tuple[int, int]] = ()
) -> list[Match]:
    """Assign joints of a log to joints of a model, each at most once.

    Args:
        log: names of the joints in the log, in its order.
        model: names of the model's joints, in its order.
        apart: pairs (log, model) that cannot be one, because one slides and the other turns.
    """
    places, order = _places(log), ORDER
    ordered = len(log) == len(model)
    if not ordered and (numbers := _from_the_base(log, len(model))) is not None:
        # A log that lacks joints mostly lacks those at the tip: fingers.
        places, ordered, order = numbers, True, FEWER * ORDER
    own = _by_own_word(log, model)
    score = np.array(
        [
            [
                _score(places[i], a, j, b, order if ordered else 0.0) + (ITS_OWN if own.get(i) == j else 0.0)
                for j, b in enumerate(model)
            ]
            for i, a in enumerate(log)
        ]
    )
    for pair in apart:
        score[pair] = -100.0
    if score.size == 0:
        return []
    found = []
    rows, columns = linear_sum_assignment(-score)
    best = float(score[rows, columns].sum())
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        if score[i, j] < NOTHING:
            continue
        barred = score.copy()
        barred[i, j] = -100.0
        other_rows, other_columns = linear_sum_assignment(-barred)
        # Without this pair, either another assignment is right, or the joint has no partner.
        second = max(float(barred[other_rows, other_columns].sum()), best - float(score[i, j]) + NOTHING)
        probability = 1.0 / (1.0 + float(np.exp(np.clip(second - best, -50.0, 50.0))))
        found.append(
            Match(
                i,
                j,
                probability,
                _reason(str(log[i]), str(model[j]), places[i] == j and ordered, own.get(i) == j),
            )
        )
    return found


def _by_own_word(log: Sequence[str], model: Sequence[str]) -> dict[int, int]:
    """Joints of a log whose words and numbers are all those of one joint of the model, and of no other: log -> model.

    ``cart`` is the joint ``cart_slide``, and ``1`` the joint ``j1_base``. What all joints of the log share tells none.
    """
    parts, of_log = ([set(_words_and_numbers(name)) for name in names] for names in (model, log))
    if not _counted_alike(log, model):
        parts, of_log = (
            [{w for w in words if not w.isdecimal()} for words in own] for own in (parts, of_log)
        )
    shared = set.intersection(*of_log) if len(of_log) > 1 else set()
    found: dict[int, int] = {}
    for i, words in enumerate(of_log):
        said = words - shared
        having = [j for j, words in enumerate(parts) if said and said <= words]
        if len(having) == 1:
            found[i] = having[0]
    taken = list(found.values())
    return {i: j for i, j in found.items() if taken.count(j) == 1}


def _counted_alike(log: Sequence[str], model: Sequence[str]) -> bool:
    """Whether both count all of their joints, each by one number of its own, and the model has those of the log."""
    numbers = [[[int(n) for n in re.findall(r"\d+", name)] for name in names] for names in (log, model)]
    if not all(len(own) == 1 for names in numbers for own in names):
        return False
    of_log, of_model = ([own[0] for own in names] for names in numbers)
    distinct = all(len(set(own)) == len(own) for own in (of_log, of_model))
    # Where one begins at 0 and the other at 1, the same numbers are other joints.
    return distinct and (0 in of_log) == (0 in of_model) and set(of_log) <= set(of_model)


def _words_and_numbers(name: str) -> list[str]:
    return [
        str(int(p)) if p.isdecimal() else p for p in re.findall(r"[a-z]+|\d+", _spaced(name)) if p != "joint"
    ]


def _places(log: Sequence[str]) -> list[int]:
    """Place of each joint in the order from the base outwards: that of the columns, where words do not tell another."""
    ranks = {}
    for i, name in enumerate(log):
        found = {r for r, words in enumerate(_ALONG) if words & set(_parts(name))}
        if len(found) == 1:
            ranks[i] = found.pop()
    places = list(range(len(log)))
    if len(set(ranks.values())) == len(ranks):
        for place, i in zip(sorted(ranks), sorted(ranks, key=lambda i: ranks[i]), strict=True):
            places[i] = place
    return places


def _from_the_base(log: Sequence[str], joints: int) -> list[int] | None:
    """Places that the numbers of joints say, counted from 0 where one is 0, else from 1; None where they say none."""
    if not log or not all(name.isdecimal() for name in log):
        return None
    numbers = [int(name) for name in log]
    places = [number - (0 not in numbers) for number in numbers]
    return places if max(places) < joints and len(set(places)) == len(places) else None


def _score(i: int, log: str, j: int, model: str, evidence: float) -> float:
    order = evidence * (1.0 if i == j else -0.5)
    if _plain(log) == _plain(model):
        return SAME + order
    if log.isdecimal():
        return order + (evidence if i == j else 0.0)
    return WORD * _shared(_parts(log), _parts(model)) + 2.0 * _spelling(log, model) + order


def _shared(a: Sequence[str], b: Sequence[str]) -> float:
    """Share of words that are the same, or mean the same, from 0 to 1."""
    if not a or not b:
        return 0.0
    free, total = list(b), 0.0
    for word in a:
        weights = [words_alike(word, other) for other in free]
        if weights and max(weights) > 0:
            total += max(weights)
            free.pop(int(np.argmax(weights)))
    return total / (0.5 * (len(a) + len(b)))


def words_alike(a: str, b: str) -> float:
    """1 for the same word, less for words of one meaning, else 0."""
    if a == b:
        return 1.0
    return 0.6 if any(a in group and b in group for group in _ALIKE) else 0.0


def _spelling(a: str, b: str) -> float:
    """How similar the spellings are beyond chance, from 0 to 1."""
    return max(SequenceMatcher(None, _plain(a), _plain(b)).ratio() - 0.6, 0.0) / 0.4


def _parts(name: str) -> list[str]:
    return [
        p
        for p in re.split(r"[^a-z]+|(?<=[a-z])(?=\d)", _spaced(name))
        if p and p not in ("joint", "motor", "pos")
    ]


def _spaced(name: str) -> str:
    """A name in lower case, its words apart."""
    return re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _reason(log: str, model: str, placed: bool, own: bool) -> str:
    if _plain(log) == _plain(model):
        return SAME_NAME
    if own:
        return f'"{log}" {ITS_WORD} of "{model}"'
    order = "the same place in the order" if placed else ""
    shared = _shared(_parts(log), _parts(model)) > 0.2 or _spelling(log, model) > 0.3
    named = f'"{log}" resembles "{model}"' if shared else ""
    return " and ".join(part for part in (named, order) if part) or "no other joint is left"

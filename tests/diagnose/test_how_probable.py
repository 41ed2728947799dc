"""Probabilities of what may stand in one place of a diagnosis."""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.how_probable import LISTED, OUTSIDE, alone, how_probable, listed

SCORES = st.lists(st.floats(-50.0, 5000.0), max_size=6)


def candidates(scores: Sequence[float]) -> list[Any]:
    return [
        SimpleNamespace(cause=SimpleNamespace(name=f"c{k}"), delta_bic=score)
        for k, score in enumerate(scores)
    ]


@given(SCORES, st.floats(APART, 600.0))
def test_probabilities_add_up_to_one(scores, wide):
    chances = how_probable(candidates(scores), 24.0, wide)
    assert sum(chances.values()) == pytest.approx(1.0)
    assert min(chances.values()) >= 0.0


def test_a_cause_at_the_threshold_is_as_probable_as_nothing():
    assert how_probable(candidates([24.0]), 24.0)["c0"] == pytest.approx((1.0 - OUTSIDE) / 2)
    assert alone("c0", 24.0, 24.0) == how_probable(candidates([24.0]), 24.0)


def test_a_difference_of_the_bic_is_twice_a_log_ratio():
    chances = how_probable(candidates([60.0, 58.0]), 24.0)
    assert chances["c0"] / chances["c1"] == pytest.approx(math.e)
    # Where differences vary three times as much, three times as much is needed for the same ratio.
    assert (wide := how_probable(candidates([60.0, 54.0]), 24.0, 3.0 * APART))["c0"] / wide[
        "c1"
    ] == pytest.approx(math.e)


def test_what_leads_a_class_by_what_is_known_beside_the_log_is_no_less_probable_than_its_members():
    scores = candidates([60.0, 64.0, 30.0])
    assert how_probable(scores, 24.0)["c1"] > how_probable(scores, 24.0)["c0"]
    chances = how_probable(scores, 24.0, members=("c0", "c1"))
    assert chances["c1"] == pytest.approx(chances["c0"])
    assert chances["c2"] < 1e-6


@given(SCORES)
def test_listed_are_the_probable_ones_with_unknown_last(scores):
    chances = how_probable(candidates(scores), 24.0)
    told = listed(chances)
    assert set(told) == {n for n, p in chances.items() if p >= LISTED}
    assert list(told)[-1] == "unknown"
    ordered = [p for n, p in told.items() if n != "unknown"]
    assert ordered == sorted(ordered, reverse=True)

"""Prior of explanations and probabilities of causes."""

import itertools
import math

import numpy as np
import pytest

from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.probability.answer import Answer, Weighed
from deepkoco.diagnose.probability.coordinates import Item
from deepkoco.diagnose.probability.explanations import Explanation, log_prior, sets_of
from deepkoco.systems import make_system

CAUSES = list(catalogue(make_system("rod_pendulum")).values())[:6]


def test_priors_of_all_explanations_without_an_unknown_cause_add_up_to_one_with_it():
    items = [Item(c, (k,), {}, 1) for k, c in enumerate(CAUSES)]
    sets = [s for size in (0, 1, 2, 3) for s in itertools.combinations(items, size)]
    total = sum(math.exp(log_prior(Explanation(s), len(items))) for s in sets)
    assert total + math.exp(log_prior(Explanation(unknown=True), len(items))) == pytest.approx(1.0)


def test_a_cause_shares_its_prior_among_its_shapes():
    one, shaped = Item(CAUSES[0], (0,), {}, 1), Item(CAUSES[0], (0,), {}, 24)
    apart = log_prior(Explanation((one,)), 6) - log_prior(Explanation((shaped,)), 6)
    assert apart == pytest.approx(math.log(24))


def test_a_set_frees_every_coordinate_once():
    both = Explanation((Item(CAUSES[0], (3, 5), {}, 1), Item(CAUSES[1], (5,), {}, 1)))
    assert sets_of([both, Explanation()]) == [[3, 5], [-1, -1]]


def answer(*found: tuple[tuple[str, ...], float, bool]) -> Answer:
    return Answer.of([Weighed(c, w, s, (0.0, 0.0), {}) for c, w, s in found], len(found), 0.0)


def test_the_probability_of_a_cause_is_the_sum_over_explanations_that_hold_it():
    found = answer(
        (("gain",), math.log(0.6), True),
        (("gain", "lag"), math.log(0.3), True),
        ((), math.log(0.1), True),
    )
    assert found.of_cause("gain") == pytest.approx(0.9)
    assert found.of_cause("lag") == pytest.approx(0.3)
    assert found.nothing == pytest.approx(0.1)
    assert list(found.causes) == ["gain", "lag"]


def test_the_credible_set_has_the_fewest_explanations_with_95_percent():
    weights = np.log([0.5, 0.3, 0.16, 0.04])
    found = answer(*(((name,), w, True) for name, w in zip("abcd", weights, strict=True)))
    assert found.credible == (("a",), ("b",), ("c",))


def test_a_start_that_ended_at_no_stationary_point_gives_way_to_one_that_did():
    found = answer((("gain",), 5.0, False), (("gain",), 2.0, True), ((), 2.0, True))
    assert found.of_cause("gain") == pytest.approx(0.5)


@pytest.mark.parametrize(("rest", "counts"), [(-60.0, -60.0), (-120.0, -57.0)])
def test_a_start_at_rest_counts_first_unless_it_is_another_minimum_far_behind(rest, counts):
    starts = [Weighed(("gain",), w, w == rest, (0.0, 0.0), {}) for w in (-57.0, -59.0, rest, rest - 1.0)]
    for found in (starts, starts[::-1]):
        assert [e.log_weight for e in Answer.of(found, 1, 0.0).explanations] == [counts]

"""Delay laws: their moments, their descriptions, and what is no delay."""

import math
from fractions import Fraction

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import truncnorm

from deepkoco.graph import DelayError, Deterministic, Empirical, Gaussian, Mixture, make_delay
from deepkoco.graph.delay import exact_seconds

seconds = st.floats(0, 2)
simple = st.one_of(
    st.builds(Deterministic, seconds),
    st.builds(Gaussian, seconds, seconds),
    st.builds(Empirical, st.lists(seconds, min_size=1, max_size=5).map(tuple)),
)
laws = st.one_of(
    simple,
    st.lists(st.tuples(simple, st.floats(0.1, 5)), min_size=1, max_size=3).map(
        lambda parts: Mixture(tuple(law for law, _ in parts), tuple(weight for _, weight in parts))
    ),
)


@given(law=laws, seed=st.integers(0, 99))
def test_draws_are_delays_and_a_seed_repeats_them(law, seed):
    draws = law.sample(np.random.default_rng(seed), (4, 3))
    assert draws.shape == (4, 3)
    assert draws.dtype == np.float64
    assert np.isfinite(draws).all()
    assert (draws >= 0).all()
    assert (draws <= law.highest).all()
    np.testing.assert_array_equal(draws, law.sample(np.random.default_rng(seed), (4, 3)))


def test_the_highest_delay_is_that_of_the_rarest_draw():
    class Rarest:
        def random(self, shape):
            return np.full(shape, 1.0 - 2.0**-53)

    for law in (Gaussian(0.03, 0.01), Gaussian(0.0, 0.2)):
        assert law.sample(Rarest(), (1,))[0] == pytest.approx(law.highest, rel=1e-12)
    assert Mixture((Deterministic(0.1), Empirical((0.2, 0.4))), (1, 1)).highest == 0.4


@given(law=laws)
def test_a_law_survives_yaml(law):
    assert make_delay(yaml.safe_load(yaml.safe_dump(law.to_dict()))) == law


@pytest.mark.parametrize(
    "law",
    [
        Gaussian(0.03, 0.01),
        Gaussian(0.01, 0.03),
        Mixture((Deterministic(0.1), Gaussian(0.01, 0.002)), (1, 3)),
        Empirical((0.1, 0.2, 0.6)),
    ],
)
def test_the_mean_is_that_of_many_draws(law):
    draws = law.sample(np.random.default_rng(0), (40_000,))
    assert abs(draws.mean() - law.mean) < 5 * draws.std() / 200


@given(loc=st.floats(0, 0.2), scale=st.floats(0.01, 0.2))
def test_the_truncated_mean_agrees_with_scipy(loc, scale):
    expected = truncnorm.mean(-loc / scale, np.inf, loc=loc, scale=scale)
    assert math.isclose(Gaussian(loc, scale).mean, expected, rel_tol=1e-9)


def test_a_number_and_a_description_become_laws():
    assert make_delay(0.02) == Deterministic(0.02)
    assert make_delay({"law": "gaussian", "loc": 0.02, "scale": 0.01}) == Gaussian(0.02, 0.01)
    assert make_delay(Gaussian(0.1, 0.0)).constant


def test_a_constant_is_read_as_the_fraction_it_was_meant_as():
    assert exact_seconds(Deterministic(1 / 60)) == Fraction(1, 60)
    assert exact_seconds(Deterministic(0.1)) == Fraction(1, 10)
    assert exact_seconds(Deterministic(math.pi / 100)) == Fraction(31415927, 10**9)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (-0.01, r"-0.01 s is no delay"),
        (math.nan, r"nan s is no delay"),
        (math.inf, r"inf s is no delay"),
        ("soon", r"'soon' is no number of seconds"),
        ({"law": "poisson", "rate": 3}, r'"poisson" is not known; known: .*gamma, gaussian'),
        ({"law": "gaussian", "mean": 0.1}, r"gaussian: .*unexpected keyword argument 'mean'"),
        ({"law": "gaussian", "loc": 0.1, "scale": -1}, r"scale: -1.0 s is no delay"),
        ({"law": "empirical", "samples": []}, r"no samples"),
        ({"law": "empirical", "samples": [0.1, -0.1]}, r"samples: -0.1 s is no delay"),
        ({"law": "mixture", "components": [0.1], "weights": [0.5, 0.5]}, r"1 components and 2 weights"),
        ({"law": "mixture", "components": [0.1], "weights": [-1]}, r"negative"),
    ],
)
def test_what_is_no_delay_is_refused(spec, message):
    with pytest.raises(DelayError, match=message):
        make_delay(spec)

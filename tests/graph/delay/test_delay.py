"""Delay laws: their moments, their descriptions, and what is no delay."""

import math
from fractions import Fraction

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import gamma, kstest, lognorm, truncnorm, uniform

from deepkoco.graph import DelayError, Deterministic, Empirical, Gaussian, Mixture, make_delay
from deepkoco.graph.delay import (
    Autoregressive,
    Gamma,
    LogNormal,
    Lossy,
    OrnsteinUhlenbeck,
    OverrunProcess,
    Uniform,
    exact_seconds,
)

seconds = st.floats(0, 2)
simple = st.one_of(
    st.builds(Deterministic, seconds),
    st.builds(Gaussian, seconds, seconds),
    st.builds(Empirical, st.lists(seconds, min_size=1, max_size=5).map(tuple)),
    st.builds(lambda low, width: Uniform(low, low + width), seconds, seconds),
    st.builds(LogNormal, seconds, st.floats(0, 2), seconds),
    st.builds(Gamma, st.floats(0.1, 50), seconds, seconds),
)
laws = st.one_of(
    simple,
    st.builds(Autoregressive, simple, st.floats(-0.99, 0.99)),
    st.builds(OrnsteinUhlenbeck, simple, st.floats(0.01, 10)),
    st.builds(OverrunProcess, seconds, st.floats(0, 1), st.floats(0.01, 1)),
    st.lists(st.tuples(simple, st.floats(0.1, 5)), min_size=1, max_size=3).map(
        lambda parts: Mixture(tuple(law for law, _ in parts), tuple(weight for _, weight in parts))
    ),
)


@settings(deadline=None)  # kernels compile at the first use
@given(law=laws, seed=st.integers(0, 99))
def test_draws_are_delays_and_a_seed_repeats_them(law, seed):
    draws = law.sample(np.random.default_rng(seed), (4, 3))
    assert draws.shape == (4, 3)
    assert draws.dtype == np.float64
    assert np.isfinite(draws).all()
    assert (draws >= 0).all()
    assert (draws <= law.highest).all()
    np.testing.assert_array_equal(draws, law.sample(np.random.default_rng(seed), (4, 3)))
    streamed = law.stream(4, 0.1).draw(np.random.default_rng(seed), 3)
    assert streamed.shape == (4, 3)
    assert (streamed >= 0).all()
    assert (streamed <= law.highest).all()


@settings(deadline=None)
@given(law=simple, level=st.floats(0, 1 - 2**-53))
def test_the_quantile_is_the_smallest_delay_of_its_probability(law, level):
    delay = float(law.quantile(np.array(level)))
    slack = 1e-9 * (1 + delay)
    assert law.cdf(np.array(delay + slack)) >= level - 1e-9
    if delay > slack:
        assert law.cdf(np.array(delay - slack)) <= level + 1e-9


@settings(deadline=None)
@given(laws=st.lists(simple, min_size=1, max_size=3), level=st.floats(0.001, 0.999), jump=st.floats(0.1, 5))
def test_the_quantile_of_a_mixture_finds_jumps_exactly(laws, level, jump):
    mixture = Mixture((*laws, Deterministic(jump)), (1.0,) * (len(laws) + 1))
    delay = float(mixture.quantile(np.array(level)))
    assert mixture.cdf(np.array(delay)) >= level
    assert mixture.cdf(np.array(delay - 1e-9)) <= level


def test_the_highest_delay_is_that_of_the_rarest_draw():
    class Rarest:
        def random(self, shape):
            return np.full(shape, 1.0 - 2.0**-53)

    for law in (Gaussian(0.03, 0.01), Gaussian(0.0, 0.2)):
        assert law.sample(Rarest(), (1,))[0] == pytest.approx(law.highest, rel=1e-12)
    assert Mixture((Deterministic(0.1), Empirical((0.2, 0.4))), (1, 1)).highest == 0.4


@settings(deadline=None)
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
        Uniform(0.01, 0.05),
        LogNormal(0.02, 0.5, 0.001),
        Gamma(2.5, 0.004, 0.001),
        OverrunProcess(0.01, 0.1),
        Lossy(Gaussian(0.03, 0.01), 0.2),
    ],
)
def test_the_mean_is_that_of_many_draws(law):
    draws = law.sample(np.random.default_rng(0), (40_000,))
    lost = np.isinf(draws)
    assert lost.any() == law.loses
    draws = draws[~lost]
    assert abs(draws.mean() - law.mean) < 5 * draws.std() / 200


@pytest.mark.parametrize(
    ("law", "oracle"),
    [
        (Gaussian(0.02, 0.01), truncnorm(-2, np.inf, loc=0.02, scale=0.01)),
        (LogNormal(0.02, 0.5, 0.001), lognorm(0.5, loc=0.001, scale=0.02)),
        (Gamma(2.5, 0.004, 0.001), gamma(2.5, loc=0.001, scale=0.004)),
        (Uniform(0.01, 0.05), uniform(0.01, 0.04)),
    ],
)
def test_distribution_functions_agree_with_scipy(law, oracle):
    delays = np.linspace(0.0, 0.1, 50)
    np.testing.assert_allclose(law.cdf(delays), oracle.cdf(delays), atol=1e-12)
    levels = np.linspace(0.001, 0.999, 50)
    np.testing.assert_allclose(law.quantile(levels), oracle.ppf(levels), rtol=1e-9, atol=1e-15)
    assert law.mean == pytest.approx(oracle.mean(), rel=1e-9)
    assert kstest(law.sample(np.random.default_rng(1), (2000,)), oracle.cdf).pvalue > 0.01


@settings(deadline=None)
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
        ({"law": "gaussian", "mean": 0.1}, r"gaussian: there is no \"mean\"; it takes loc, scale"),
        ({"law": "gaussian", "loc": 0.1, "scale": -1}, r"scale: -1.0 s is no delay"),
        ({"law": "empirical", "samples": []}, r"no samples"),
        ({"law": "empirical", "samples": [0.1, -0.1]}, r"samples: -0.1 s is no delay"),
        ({"law": "mixture", "components": [0.1], "weights": [0.5, 0.5]}, r"1 components and 2 weights"),
        ({"law": "mixture", "components": [0.1], "weights": [-1]}, r"negative"),
        ({"law": "uniform", "low": 0.2, "high": 0.1}, r"high 0.1 s is below low 0.2 s"),
        ({"law": "gamma", "shape": 0, "scale": 0.1}, r"gamma: shape: 0.0 is not in"),
        ({"law": "lognormal", "median": 0.1, "sigma": math.nan}, r"lognormal: sigma: nan is not in"),
        ({"law": "autoregressive", "delay": 0.1, "correlation": 1}, r"correlation: 1.0 is not in"),
        ({"law": "ornstein_uhlenbeck", "delay": 0.1, "time_constant": 0}, r"time_constant 0 s"),
        ({"law": "lossy", "delay": 0.1, "probability": 1}, r"probability: 1.0 is not in \[0.0, 1.0\)"),
        (
            {"law": "lossy", "delay": {"law": "lossy", "delay": 1, "probability": 0.1}, "probability": 0},
            "already",
        ),
        (
            {
                "law": "autoregressive",
                "delay": {"law": "lossy", "delay": 1, "probability": 0.1},
                "correlation": 0,
            },
            "put autoregressive into lossy",
        ),
    ],
)
def test_what_is_no_delay_is_refused(spec, message):
    with pytest.raises(DelayError, match=message):
        make_delay(spec)

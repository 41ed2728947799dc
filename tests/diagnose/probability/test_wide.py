"""Evidence of freed coordinates compared with numerical integration."""

import itertools

import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.probability.wide import freed, log_cauchy_normal


def integral(information: float, pull: float, wide: float, low: float, high: float) -> float:
    """Numerical integral of exp(pull d - information d^2 / 2) under a Cauchy prior between two bounds."""
    top = 0.5 * pull**2 / information
    share = (np.arctan(high / wide) - np.arctan(low / wide)) / np.pi

    def density(d: float) -> float:
        prior = wide / (np.pi * (wide**2 + d**2)) / share
        return np.exp(pull * d - 0.5 * information * d**2 - top) * prior

    sd, middle = information**-0.5, pull / information
    edges = sorted({low, high, *np.clip(np.linspace(middle - 12 * sd, middle + 12 * sd, 41), low, high)})
    edges = [e for e in edges if np.isfinite(e)]
    parts = [scipy.integrate.quad(density, a, b, epsabs=0.0)[0] for a, b in itertools.pairwise(edges)]
    if not np.isfinite(high):
        parts.append(scipy.integrate.quad(density, edges[-1], np.inf)[0])
    if not np.isfinite(low):
        parts.append(scipy.integrate.quad(density, -np.inf, edges[0])[0])
    return float(np.log(sum(parts)) + top)


def one(information, pull, wide, low, high) -> float:
    found = freed(np.array([[[information]]]), *(np.array([[v]]) for v in (pull, wide, low, high)))
    return float(found.log_gain[0])


@settings(max_examples=60, deadline=None)
@given(
    exponent=st.floats(-1.5, 4.0),
    sds=st.floats(-6.0, 25.0),
    wide=st.floats(0.1, 10.0),
    bounded=st.booleans(),
)
def test_one_freed_coordinate_is_integrated_exactly(exponent, sds, wide, bounded):
    information = 10.0**exponent / wide**2
    pull = sds * information**0.5
    low = 0.0 if bounded else -np.inf
    expected = integral(information, pull, wide, low, np.inf)
    assert one(information, pull, wide, low, np.inf) == pytest.approx(expected, abs=0.02)


def test_the_example_of_the_page():
    # Log likelihood 0.05 x 500 / 2, then log(0.63 x 0.01 x sqrt(2 pi)) of the prior.
    assert one(1e4, 500.0, 0.5, -np.inf, np.inf) == pytest.approx(12.5 - 4.15, abs=0.02)


def test_a_coordinate_without_information_gains_nothing():
    assert one(0.0, 0.0, 3.0, -np.inf, np.inf) == pytest.approx(0.0, abs=1e-6)
    assert one(0.0, 0.0, 3.0, 0.0, 9.0) == pytest.approx(0.0, abs=1e-6)


def test_two_correlated_coordinates_are_integrated_within_a_tenth_of_a_nat():
    information, pull = np.array([[40.0, 25.0], [25.0, 30.0]]), np.array([60.0, 10.0])
    wide = np.array([0.5, 2.0])

    def density(y: float, x: float) -> float:
        d = np.array([x, y])
        prior = np.prod(wide / (np.pi * (wide**2 + d**2)))
        return float(np.exp(pull @ d - 0.5 * d @ information @ d) * prior)

    expected = np.log(scipy.integrate.dblquad(density, -8.0, 8.0, -8.0, 8.0)[0])
    unbounded = np.full((1, 2), np.inf)
    found = freed(information[None], pull[None], wide[None], -unbounded, unbounded)
    assert found.log_gain[0] == pytest.approx(expected, abs=0.1)


def test_coordinates_that_fill_the_array_change_nothing():
    fill = freed(
        np.array([[[9.0, 7.0], [7.0, 5.0]]]),
        np.array([[12.0, 4.0]]),
        np.array([[1.0, np.inf]]),
        np.array([[0.0, -np.inf]]),
        np.full((1, 2), np.inf),
    )
    assert fill.log_gain[0] == pytest.approx(one(9.0, 12.0, 1.0, 0.0, np.inf), abs=1e-9)


def test_the_point_of_linearisation_does_not_matter():
    information, pull, wide, at = 30.0, 20.0, 0.7, 0.4
    moved = freed(
        np.array([[[information]]]),
        np.array([[pull - information * at]]),
        np.array([[wide]]),
        np.array([[-np.inf]]),
        np.array([[np.inf]]),
        np.array([[at]]),
    )
    # The log likelihood at that point is the reference of the gain.
    there = pull * at - 0.5 * information * at**2
    assert moved.log_gain[0] + there == pytest.approx(one(information, pull, wide, -np.inf, np.inf), abs=1e-9)


def test_a_bound_far_above_the_estimate_leaves_the_tail():
    # The likelihood exp(g d) decays from the bound with g = -200: the integral is p(0) / 200 to first order.
    found = log_cauchy_normal(np.array([1.0]), np.array([-200.0]), np.array([0.0]), np.array([np.inf]))
    expected = np.log(2.0 / np.pi / 200.0) - 0.5 * 200.0**2
    assert found[0] == pytest.approx(expected, abs=1e-3)

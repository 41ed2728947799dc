"""The covariance of estimates beside a prior, where rounding hides which of the two tells a direction."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.solve.covariance import covariance_of
from deepkoco.fit.solve.scaled_inverse import scaled_inverse


def information(size: int, seed: int) -> np.ndarray:
    slopes = np.random.default_rng(seed).standard_normal((40, size))
    return slopes.T @ slopes


@settings(max_examples=50, deadline=None)
@given(size=st.integers(1, 6), seed=st.integers(0, 1000))
def test_the_inverse_where_data_tell_every_direction(size, seed):
    data, prior = information(size, seed), np.diag(np.linspace(0.1, 2.0, size))
    np.testing.assert_array_equal(covariance_of(data + prior, prior), scaled_inverse(data + prior))


@settings(max_examples=100, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    power=st.floats(-13.5, -10.0),
    unit=st.sampled_from([1e-9, 1.0, 1e6]),
    rounding=st.floats(-1e-10, 1e-10),
)
def test_rounding_of_two_equal_slopes_leaves_their_prior(seed, power, unit, rounding):
    # An offset of the load and a dead zone that the command never crosses have the same slopes.
    slopes = np.random.default_rng(seed).standard_normal((40, 3))
    slopes = np.column_stack([slopes, slopes[:, 2]])
    data, precision = slopes.T @ slopes, np.diag([1.0, 1.0, 2.0, 2.0]) * 10.0**power
    across = np.array([0.0, 0.0, 1.0, -1.0])
    data += 0.25 * rounding * np.outer(across, across)
    scale = np.outer(*2 * [[1.0, 1.0, 1.0, unit]])
    found = covariance_of((data + precision) * scale, precision * scale) * scale
    assert np.linalg.eigvalsh(found).min() > 0.0
    assert (np.diagonal(found) <= 1.001 / np.diagonal(precision)).all()
    if rounding < -1e-12:
        # Their sum is known from the data, their difference from the prior alone: its variance is 2 / precision.
        assert across @ found @ across == pytest.approx(2.0 / precision[2, 2], rel=1e-3)


def test_without_a_prior_the_pseudo_inverse_is_returned():
    slopes = np.ones((5, 2))
    np.testing.assert_allclose(covariance_of(slopes.T @ slopes, np.zeros((2, 2))), np.full((2, 2), 0.05))


def test_no_parameters_have_an_empty_covariance():
    assert covariance_of(np.zeros((0, 0)), np.zeros((0, 0))).shape == (0, 0)

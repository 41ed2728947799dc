"""Liftings against independent implementations and hand-worked cases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RBFInterpolator
from sklearn.preprocessing import PolynomialFeatures

from deepkoco.koopman.lifting.lifting import (
    FunctionLifting,
    LiftingError,
    Polynomial,
    RadialBasis,
    RandomFourier,
    TimeDelays,
    stack_history,
)


@settings(max_examples=15, deadline=None)
@given(size=st.integers(1, 4), degree=st.integers(1, 4), bias=st.booleans(), interaction=st.booleans())
def test_monomials_are_those_of_scikit_learn(size, degree, bias, interaction):
    o = np.random.default_rng(size).normal(size=(5, size))
    ours = Polynomial(size, degree, bias, interaction)
    theirs = PolynomialFeatures(degree, include_bias=bias, interaction_only=interaction).fit_transform(o)
    assert ours.size == theirs.shape[1]
    np.testing.assert_allclose(ours(o), theirs, rtol=1e-12)
    np.testing.assert_allclose(ours(o[0]), theirs[0], rtol=1e-12)


def test_thin_plates_are_the_radial_functions_of_scipys_interpolator():
    rng = np.random.default_rng(0)
    centers = rng.normal(size=(6, 2))
    weights = rng.normal(size=6)
    lifting = RadialBasis(centers, "thinplate", include_observation=False)
    # An interpolator of any data is its own combination of thin plates at the data plus an affine part.
    data = rng.normal(size=6)
    interpolator = RBFInterpolator(centers, data, kernel="thin_plate_spline")
    points = rng.normal(size=(20, 2))
    regressors = np.hstack((lifting(points), np.ones((20, 1)), points))
    fitted, *_ = np.linalg.lstsq(regressors, interpolator(points))
    np.testing.assert_allclose(regressors @ fitted, interpolator(points), atol=1e-10)
    assert np.isfinite(lifting(centers) @ weights).all()  # 0 log 0 at a centre is 0


def test_radial_functions_by_hand():
    centers = np.array([[0.0, 0.0], [3.0, 4.0]])  # squared distances 0 and 25 from the origin
    o = np.zeros(2)
    expected = {
        "gauss": [1.0, np.exp(-4 * 25)],
        "invquad": [1.0, 1 / 101],
        "invmultquad": [1.0, 1 / np.sqrt(101)],
        "thinplate": [0.0, 25 * np.log(5)],
        "polyharmonic": [0.0, 125 * np.log(5)],
    }
    for kernel, values in expected.items():
        lifting = RadialBasis(centers, kernel, width=2.0, power=3.0)
        np.testing.assert_allclose(lifting(o), [0.0, 0.0, *values], rtol=1e-12)


def test_fourier_features_have_unit_length():
    lifting = RandomFourier(np.random.default_rng(1).normal(size=(7, 3)), include_observation=False)
    features = lifting(np.random.default_rng(2).normal(size=(4, 3)))
    np.testing.assert_allclose(np.square(features).sum(-1), 1.0)


def test_delays_take_every_stride_th_observation_newest_first():
    lifting = TimeDelays(2, delays=2, stride=2)
    episode = np.array([[k, 10 + k] for k in range(7)], dtype=float)
    stacked = stack_history(episode, lifting.window)
    assert stacked.shape == (3, 10)
    np.testing.assert_array_equal(lifting(stacked)[0], [4, 14, 2, 12, 0, 10])
    np.testing.assert_array_equal(lifting(stacked)[-1], [6, 16, 4, 14, 2, 12])


def test_what_cannot_be_lifted_is_named():
    with pytest.raises(LiftingError, match="degree"):
        Polynomial(2, 0)
    with pytest.raises(LiftingError, match="gauss"):
        RadialBasis(np.ones((1, 2)), "gaussian")
    with pytest.raises(LiftingError, match="stride"):
        TimeDelays(2, 1, 0)
    with pytest.raises(LiftingError, match="3 observations"):
        stack_history(np.ones((3, 2)), 4)
    with pytest.raises(LiftingError, match="should give"):
        FunctionLifting(lambda o: o, 2, 3)(np.ones((4, 2)))

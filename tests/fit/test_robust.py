"""Weights of windows that are much worse than the others."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import gammaln

from deepkoco.fit.solve.robust import DEGREES, weights


def t_misfit(typical, error, count):
    """Minus log likelihood of windows of `count` errors each under a multivariate t distribution."""
    quadratic = count * error / typical
    return float(
        (
            0.5 * count * np.log(typical)
            + 0.5 * (DEGREES + count) * np.log1p(quadratic / DEGREES)
            - gammaln(0.5 * (DEGREES + count))
        ).sum()
    )


def test_weights_belong_to_the_most_likely_typical_error():
    rng = np.random.default_rng(20000)
    error, count = rng.chisquare(5, 30) / 5 * 3.0, np.full(30, 5.0)
    error[4] *= 300.0
    weight, typical = weights(error, count)
    best: Any = minimize_scalar(
        lambda x: t_misfit(np.exp(x), error, count), bounds=(-5.0, 8.0), method="bounded"
    )
    assert typical == pytest.approx(np.exp(best.x), rel=1e-3)
    assert weight[4] < 0.05
    np.testing.assert_allclose(weight, (DEGREES + count) / (DEGREES + count * error / typical), rtol=1e-4)


def test_one_bad_window_hardly_moves_the_typical_error():
    error, count = np.ones(20), np.full(20, 4.0)
    _, clean = weights(error, count)
    error[0] = 1e6
    _, spoilt = weights(error, count)
    assert clean == pytest.approx(1.0)
    assert spoilt < 1.2


def test_windows_without_samples_or_errors_keep_their_weight():
    weight, typical = weights(np.zeros(3), np.array([4.0, 0.0, 4.0]))
    np.testing.assert_array_equal(weight, 1.0)
    assert typical == 0.0

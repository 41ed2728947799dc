"""Intervals of parameters that move together end where one of them meets its bound."""

import numpy as np
import pytest

from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.verdict.findings import while_others_may
from deepkoco.systems import Parameter

SD = 0.05
DELAYS = tuple(Parameter(n, 0.0, "s", 0.0, 0.2, SD, "delay") for n in ("actuation", "sensing"))


def told_in_sum(values, alone):
    """Covariance of two delays with a common prior, of which the data tell the sum with the error ``alone``."""
    data = np.ones((2, 2)) / alone**2
    return np.asarray(values), np.linalg.inv(data + np.eye(2) / SD**2)


def interval(values, covariance, i):
    reach = 1.96 * np.sqrt(covariance[i, i])
    wide = Estimate(values[i], max(values[i] - reach, 0.0), min(values[i] + reach, 0.2), "s")
    return while_others_may(wide, i, values, covariance, DELAYS)


def test_of_two_delays_that_are_told_in_sum_neither_is_longer_than_the_sum():
    values, covariance = told_in_sum((0.002, 0.015), 1e-5)
    for i in range(2):
        found = interval(values, covariance, i)
        assert found.low == 0.0
        assert found.high == pytest.approx(0.017, abs=1e-4)


def test_the_interval_holds_what_the_other_leaves_beyond_its_bound():
    values, covariance = told_in_sum((0.0, 0.017), 1e-3)
    found = interval(values, covariance, 1)
    assert 0.017 + 1e-3 < found.high < 0.017 + 3e-3
    assert found.value == 0.017


def test_parameters_that_are_told_apart_keep_their_intervals():
    values, covariance = np.array([0.0, 0.017]), np.array([[1e-6, -0.9e-6], [-0.9e-6, 1e-6]])
    found = interval(values, covariance, 1)
    assert (found.low, found.high) == pytest.approx((0.017 - 1.96e-3, 0.017 + 1.96e-3))

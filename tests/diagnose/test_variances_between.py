"""Run-to-run variances from the likelihoods of several logs."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.run_to_run import LogInformation
from deepkoco.diagnose.variances_between import variances_between
from deepkoco.fit.solve.prior import Prior


def told(information: np.ndarray, estimate: np.ndarray) -> LogInformation:
    return LogInformation(information, information @ estimate)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 8))
def test_variances_between_of_separate_parameters_are_those_of_their_estimates(seed, count):
    rng = np.random.default_rng(seed)
    prior = Prior(("a", "b"), np.zeros(2), 400.0 * np.eye(2))
    precision = np.diag([1e4, 25.0])
    estimates = rng.normal(size=(count, 2)) * [0.5, 1.0]
    found = variances_between([told(precision, e) for e in estimates], prior, np.array([9.0, 9.0]))
    # Restricted likelihood with equal errors: the sample variance less that of the errors, or 0.
    wanted = np.maximum(estimates.var(0, ddof=1) - 1.0 / np.diag(precision), 0.0)
    np.testing.assert_allclose(found, wanted, atol=0.02, rtol=0.02)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_variances_between_are_zero_where_correlated_errors_explain_the_estimates(seed):
    rng = np.random.default_rng(seed)
    prior = Prior(("a", "b"), np.zeros(2), np.eye(2))
    # A log shows a - b to 0.01 and their sum to 0.5 only.
    ways = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    precision = ways.T @ np.diag([1e4, 4.0]) @ ways
    along = rng.normal(size=4) * 0.3
    logs = [told(precision, x * ways[1]) for x in along]
    start = np.full(2, np.var(along, ddof=1))
    assert variances_between(logs, prior, start).max() < 0.02 * start[0]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 6))
def test_usual_variances_end_where_likelihood_and_half_cauchy_are_largest(seed, count):
    rng = np.random.default_rng(seed)
    prior, error, usual = Prior(("a",), np.zeros(1), 400.0 * np.eye(1)), 0.1, 0.3
    estimates = rng.normal(size=count)
    logs = [told(np.array([[error**-2]]), np.array([x])) for x in estimates]
    found = variances_between(logs, prior, np.ones(1), usual=np.array([usual**2]))[0]
    squares, degrees = float(np.sum((estimates - estimates.mean()) ** 2)), count - 1

    def less_likely(variance):
        all_of = variance + error**2
        likelihood = 0.5 * (degrees * np.log(all_of) + squares / all_of)
        return likelihood + np.log1p(variance / usual**2) / 6.0  # half-Cauchy of the standard deviation

    grid = np.concatenate([[0.0], np.logspace(-6, 1.5, 4000)])
    assert less_likely(found) < less_likely(grid).min() + 1e-3


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 6))
def test_a_clear_variance_is_the_median_of_its_posterior(seed, count):
    rng = np.random.default_rng(seed)
    estimates = rng.normal(size=count)
    estimates /= estimates.std()
    logs = [told(np.array([[1e8]]), np.array([x])) for x in estimates]
    found = variances_between(
        logs, Prior(("a",), np.zeros(1), 400.0 * np.eye(1)), np.ones(1), usual=np.array([1e-9])
    )
    # Far above its scale a half-Cauchy density of s falls with s^-2, so the variance is inverse gamma.
    squares = np.sum((estimates - estimates.mean()) ** 2)
    median = scipy.stats.invgamma(0.5 * count, scale=0.5 * squares).median()
    assert found[0] == pytest.approx(median, rel=0.05)

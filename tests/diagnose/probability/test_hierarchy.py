"""The distribution of a further log compared with a dense joint normal distribution of all logs."""

from typing import Any

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.probability.gram import WindowSums
from deepkoco.diagnose.probability.hierarchy import about_mean, of_next_log
from deepkoco.diagnose.probability.normal import Normal

Q, SAMPLES = 3, 9


def logs(seed: int, count: int):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((count, SAMPLES, Q))
    return columns, 1.5 * rng.standard_normal((count, SAMPLES))


def gram(columns, residual):
    none = np.zeros((1, SAMPLES, 0))
    return WindowSums(columns[None], none, none, residual[None]).at(0.0)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 3), shared=st.booleans())
def test_further_log_and_evidence_are_those_of_the_joint_normal_distribution(seed, count, shared):
    columns, residual = logs(seed, count)
    sd, spread = np.array([0.5, 2.0, 1.0]), np.array([0.0 if shared else 0.3, 0.7, 0.05])
    mean = np.array([0.2, -1.0, 0.5])
    # Joint distribution of the measurements of all logs and of the coordinates z of one further log.
    tall = columns.reshape(count * SAMPLES, Q)
    shared_cov, own_cov = np.diag(sd**2), np.diag(spread**2)
    cov = np.eye(count * SAMPLES) + tall @ shared_cov @ tall.T
    for k in range(count):
        mine = slice(k * SAMPLES, (k + 1) * SAMPLES)
        cov[mine, mine] += columns[k] @ own_cov @ columns[k].T
    across = shared_cov @ tall.T
    expected_mean = mean + across @ np.linalg.solve(cov, residual.ravel() - tall @ mean)
    expected_cov = shared_cov + own_cov - across @ np.linalg.solve(cov, across.T)
    declared = Normal.of(mean, np.diag(1.0 / sd**2))
    found, log_evidence = of_next_log(
        [gram(c, r) for c, r in zip(columns, residual, strict=True)], declared, spread
    )
    np.testing.assert_allclose(found.mean, expected_mean, atol=1e-7)
    np.testing.assert_allclose(np.linalg.inv(found.precision), expected_cov, rtol=1e-6, atol=1e-9)
    density: Any = scipy.stats.multivariate_normal
    expected = density(tall @ mean, cov).logpdf(residual.ravel())
    assert log_evidence + -0.5 * count * SAMPLES * np.log(2 * np.pi) == pytest.approx(expected, abs=1e-6)


def test_about_the_mean_is_the_formula_of_the_page():
    columns, residual = logs(5, 1)
    own, spread = gram(columns[0], residual[0]), np.array([0.3, 0.7, 0.05])
    inverse = np.diag(1.0 / spread**2)
    middle = np.linalg.inv(own.information + inverse)
    information, pull, _ = about_mean(own, spread)
    np.testing.assert_allclose(information, inverse - inverse @ middle @ inverse, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(pull, inverse @ middle @ own.pull, rtol=1e-8)

"""Joint fit of healthy logs that leaves more than noise: its prior counts as much as its residuals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.healthy_spread import jointly_fitted
from deepkoco.diagnose.per_log_refits import SETTLED
from deepkoco.diagnose.run_to_run import posterior
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.prior import Prior
from tests.diagnose.test_run_to_run import healthy

DRAG = {"quadratic": {"drag": 0.02}}


def away(unit) -> float:
    """Squared distance of a joint fit from the prior as declared."""
    prior = unit.before.prior
    off = np.array([unit.fit.values[n] for n in prior.names]) - prior.centre
    return float(off @ prior.precision(prior.names) @ off)


def test_logs_that_are_explained_to_their_noise_are_not_fitted_again():
    unit = healthy({})
    assert jointly_fitted(unit) is unit


def test_a_model_error_lets_the_prior_count_more():
    unit = healthy(DRAG)
    joint = jointly_fitted(unit)
    left = dispersion(joint.fit, joint.windows).deflation
    assert left > 50.0
    assert SETTLED < joint.tempering / left < 1.0 / SETTLED
    assert away(joint) < away(unit)
    # It is the better fit where residuals count by what they tell.
    cost = [u.fit.chi2 / left + away(u) for u in (joint, unit)]
    assert cost[0] < cost[1]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(1.0, 100.0))
def test_the_posterior_removes_the_prior_of_the_fit_and_adds_the_one_that_counts(seed, deflation):
    rng = np.random.default_rng(seed)
    names, slopes = ("a", "b", "c"), rng.normal(size=(2, 3))  # two measurements of three parameters
    data = slopes.T @ slopes
    counts = Prior(names, np.zeros(3), np.diag(rng.uniform(0.5, 2.0, 3)))
    of_fit = Prior(names, np.zeros(3), counts.covariance / rng.uniform(1.0, 50.0))

    class Found:
        free, covariance = names, np.linalg.inv(data + of_fit.precision(names))

    expected = np.linalg.inv(data / deflation + counts.precision(names))
    assert posterior(Found, counts, deflation, of_fit) == pytest.approx(expected, rel=1e-7, abs=1e-9)

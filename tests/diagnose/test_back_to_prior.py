"""Fits far from their prior start again near it, and the lower cost counts."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.evidence.back_to_prior import back_to_prior
from deepkoco.diagnose.evidence.priors import strained
from deepkoco.fit import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.systems import make_system
from tests.fit.identify_logs import arm_log


@pytest.fixture(scope="module")
def arm():
    system = make_system("two_link_arm")
    windows = cut_windows([arm_log(0)], system, 1.0)
    start = baseline_from(system, windows)
    return FitProblem(start.system, windows), start, refit(start, windows)


def stopped_far_away(problem, start, fit, sds):
    """A fit that ended with every parameter so many prior standard deviations from its mean."""
    names, prior = start.prior.names, start.prior
    far = dict(zip(names, prior.centre + sds * np.sqrt(prior.covariance.diagonal()), strict=True))
    values = {**fit.values, **{n: max(v, start.system.parameter(n).low) for n, v in far.items()}}
    state, _ = problem.fit_states(values, fit.state)
    return problem.fit([Trial("far", fit.free, prior, values, state, fit.nuisance)], 1)[0]


def test_a_fit_that_stopped_far_from_its_prior_finds_the_minimum_near_it(arm):
    problem, start, fit = arm
    far = stopped_far_away(problem, start, fit, 3.0)
    assert strained(problem, start, far)
    found = back_to_prior(problem, start, (), far)
    assert found.cost < far.cost
    assert found.cost == pytest.approx(fit.cost, abs=1.0)


def test_a_fit_near_its_prior_is_left_as_it_is(arm):
    problem, start, fit = arm
    near = replace(start.prior, centre=np.array([fit.values[n] for n in start.prior.names]))
    best = problem.fit([Trial("best", fit.free, near, fit.values, fit.state, fit.nuisance)], 40)[0]
    assert back_to_prior(problem, replace(start, prior=near), (), best) is best


def test_a_fit_that_data_hold_far_from_its_prior_stays(arm):
    problem, start, fit = arm
    # The same fit under a prior whose means are elsewhere: no start makes its cost lower.
    prior = replace(start.prior, centre=start.prior.centre + 8.0 * np.sqrt(start.prior.covariance.diagonal()))
    elsewhere = replace(start, prior=prior)
    best = problem.fit([Trial("best", fit.free, prior, fit.values, fit.state, fit.nuisance)], 40)[0]
    assert strained(problem, elsewhere, best)
    assert back_to_prior(problem, elsewhere, (), best).cost == pytest.approx(best.cost, abs=1.0)

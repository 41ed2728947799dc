"""What slopes say a learned load could gain over the causes that are selected."""

import numpy as np

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.residual_model import load_may_win
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
LEAST = 30.0


def fitted(cause: str, hidden: dict):
    """A log with something hidden, fitted with one cause; what :func:`load_may_win` is asked with."""
    log = hidden_log("rod_pendulum", hidden, "steps", 130, 10.0)
    windows = cut_data([log], (), SYSTEM, 1.6).train
    start, named = baseline_from(SYSTEM, windows), catalogue(SYSTEM)[cause]
    problem = FitProblem(start.system, windows)
    values = {**start.values, **{n: start.values.get(n, 0.0) for n in problem.names}}
    prior = prior_with(problem, start, [named], values)
    fit = problem.fit_one(Trial(cause, prior.names, prior, values))
    return start, problem, fit, (named,), missing_torque(problem, fit)


def test_beside_the_true_cause_a_load_has_nothing_to_gain():
    assert not load_may_win(*fitted("viscous", {"viscous": {"coefficient": 0.02}}), LEAST)


def test_beside_a_false_cause_a_load_can_gain():
    assert load_may_win(*fitted("torque_bias", {"coulomb": {"torque": 0.1}}), LEAST)


def test_an_undecided_prior_leaves_the_fits_to_decide():
    start, problem, fit, _, missing = fitted("viscous", {"viscous": {"coefficient": 0.02}})
    assert load_may_win(start, problem, fit, (), missing, LEAST)


def test_ranges_of_a_load_without_weights_change_nothing():
    _, problem, fit, _, _ = fitted("viscous", {"viscous": {"coefficient": 0.02}})
    theta = np.array([[fit.values[n] for n in problem.names]] * 2)
    theta[1, problem.names.index("learned.speed_scale")] = 7.0
    nuisance, state = fit.nuisance[None].repeat(2, 1), fit.state[None].repeat(2, 1, 1)
    given, scaled = problem.predict(theta, state, nuisance)
    assert (given == scaled).all()

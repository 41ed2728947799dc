"""Healthy logs of one unit tell how far its parameters vary from run to run, and how large its model error is."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.baseline import Healthy, refit_sharply, start_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.healthy import Claim, allowed, learn_baseline, run_to_run
from deepkoco.diagnose.run_to_run import posterior, sampling_variance
from deepkoco.diagnose.selection import prior_with
from deepkoco.identify.fit import FitProblem, Trial
from deepkoco.identify.prior import Prior
from deepkoco.identify.windows import cut_windows, window_length
from deepkoco.systems import make_system
from experiments.hidden.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
LENGTH, SECONDS, SEED = window_length(SYSTEM), 10.0, 77
DRIVES = ("chirp", "steps", "chirp", "steps")


def healthy(*hidden) -> Healthy:
    """Logs of one unit, each with something else beside it, and their pooled fit."""
    logs = [
        hidden_log("rod_pendulum", own, drive, SEED, SECONDS)
        for own, drive in zip(hidden, DRIVES, strict=False)
    ]
    windows = cut_windows(logs, SYSTEM, LENGTH)
    start = start_from(SYSTEM, windows)
    windows, fit = refit_sharply(start, windows)
    return Healthy(tuple(logs), windows, start, (), fit)


def test_what_varies_is_found_and_does_not_count_as_model_error():
    change = [0.0, 0.03, 0.06, 0.09]
    unit = healthy(*({"viscous": {"change": c}} if c else {} for c in change))
    assert unit.fit.chi2 / unit.windows.samples > 10.0  # no single friction explains all four
    runs = run_to_run(unit, unit.before.prior)
    assert len(runs.said) == 4
    assert runs.floor < 1.2
    spread = dict(zip(unit.before.prior.names, np.sqrt(np.diag(runs.covariance)), strict=True))
    assert spread["viscous"] == pytest.approx(np.std(change, ddof=1), rel=0.1)
    learned = runs.of_another(unit.before.prior)
    sd = dict(zip(learned.names, np.sqrt(np.diag(learned.covariance)), strict=True))
    assert sd["viscous"] > spread["viscous"]
    # What did not vary is not blurred by what did.
    assert sd["gravity"] < 0.05


def test_one_unit_that_stays_as_it_is_does_not_vary():
    unit = healthy({}, {}, {})
    runs = run_to_run(unit, unit.before.prior)
    spread = np.sqrt(np.diag(runs.covariance))
    declared = np.sqrt(np.diag(unit.before.prior.covariance))
    assert (spread < 0.2 * declared).all()
    assert runs.floor < 1.1


def test_a_single_log_says_nothing_of_another_run():
    unit = healthy({})
    assert run_to_run(unit, unit.before.prior) is None


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(1.0, 1000.0))
def test_covariances_are_those_of_linear_least_squares(seed, deflation):
    rng = np.random.default_rng(seed)
    names = ("a", "b", "c")
    slopes = rng.normal(size=(8, 3)) * 10.0 ** rng.uniform(-2.0, 2.0, 3)
    root = rng.normal(size=(3, 3))
    prior = Prior(names, np.zeros(3), root @ root.T + 0.1 * np.eye(3))
    precision, data = np.linalg.inv(prior.covariance), slopes.T @ slopes
    order = [2, 0, 1]
    covariance = np.linalg.inv(data + precision)
    fit = SimpleNamespace(free=tuple(names[i] for i in order), covariance=covariance[np.ix_(order, order)])
    # Noise of this variance reaches the estimate through the gain of the fit.
    gain = covariance @ slopes.T
    np.testing.assert_allclose(
        sampling_variance(fit, prior, deflation), deflation * np.diag(gain @ gain.T), rtol=1e-4, atol=1e-8
    )
    wide = posterior(fit, prior, deflation)
    np.testing.assert_allclose(wide, np.linalg.inv(data / deflation + precision), rtol=1e-5, atol=1e-9)
    assert np.linalg.eigvalsh(prior.covariance - wide).min() > -1e-6


def claimed(start, effort: float):
    """An offset of that size, as another log of the unit shows it."""
    hidden = {"torque_bias": {"effort": effort}}
    windows = cut_windows([hidden_log("rod_pendulum", hidden, "steps", SEED, SECONDS)], SYSTEM, LENGTH)
    windows, reference = refit_sharply(start, windows)
    problem, cause = FitProblem(start.system, windows), catalogue(SYSTEM)["torque_bias"]
    prior = prior_with(problem, start, [cause], reference.values)
    trial = Trial(cause.name, prior.names, prior, reference.values, reference.state, reference.zero)
    return problem, Claim(cause, (), problem.fit([trial])[0])


def test_what_one_healthy_log_shows_is_allowed_and_nothing_else():
    unit = [{}, {"torque_bias": {"effort": 0.003}}]
    logs = [
        hidden_log("rod_pendulum", own, drive, SEED, SECONDS)
        for own, drive in zip(unit, DRIVES, strict=False)
    ]
    start = learn_baseline(logs, SYSTEM, LENGTH)
    assert len(start.runs.said) == 2
    assert "torque_bias" not in start.effects  # too small to be learned
    problem, same = claimed(start, 0.003)
    assert allowed(start, problem, [same]) == [True]
    problem, more = claimed(start, 0.05)
    assert allowed(start, problem, [more]) == [False]

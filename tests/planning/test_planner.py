"""The controller keeps its promises when a program cannot be solved."""

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from deepkoco.planning import METHODS, PlannerConfig, PlannerConfigError, UnknownSolverError, make_planner
from deepkoco.planning.config import CHOICES
from deepkoco.planning.methods import FROZEN_FORMS, LINEARISATIONS, VARYING_FORMS

FORMS = [
    PlannerConfig(5),
    PlannerConfig(5, solver="osqp"),
    PlannerConfig(5, solver="piqp"),
    PlannerConfig(5, form="sparse", tolerance=1e-9),
]
EVERY = [
    *FORMS,
    PlannerConfig(5, linearisation="cost_along_plan"),
    PlannerConfig(5, linearisation="along_plan"),
    PlannerConfig(5, linearisation="tangent"),
    PlannerConfig(5, method="cem", samples=20, sample_iterations=2, elites=4),
]
NUMBERS = st.floats(width=64) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e300, -1e-300, 1e20])


def make(model, config, limit=1.5):
    bounds = np.full(model.action_size, limit)
    return make_planner(model, config, -bounds, bounds)


@pytest.mark.parametrize("config", FORMS, ids=lambda c: f"{c.form}-{c.solver}")
def test_next_action_stays_inside_the_limits(random_state, config, model):
    planner = make(model, config, 0.3)
    for seed in range(20):
        rows, factor, action = random_state(model, seed)
        action = np.clip(action, -0.3, 0.3)
        assert np.abs(action + planner.plan(rows, factor, action)).max() <= 0.3 + 1e-12
    assert planner.statistics.plans == 20
    assert planner.statistics.failures == 0


@pytest.mark.parametrize("config", FORMS, ids=lambda c: f"{c.form}-{c.solver}")
def test_failures_take_the_last_plan_step_by_step_and_then_hold(random_state, config, model, caplog):
    # Weak input and wide limits: no action is clipped, so increments can be compared.
    planner = make(model, config, 1e3)
    rows, factor, action = random_state(model, 1)
    rows[1:] *= 0.01
    planned = planner._program.solve(rows, factor, action)
    expected = np.diff(planned, axis=0, prepend=action[None])
    planner.plan(rows, factor, action)
    broken = rows * np.nan
    for k in range(1, 5):
        action = action + expected[k - 1]
        np.testing.assert_allclose(planner.plan(broken, factor, action), expected[k], atol=1e-5)
    action = action + expected[4]
    np.testing.assert_allclose(planner.plan(broken, factor, action), 0.0, atol=1e-5)
    assert planner.statistics.failures == 5
    assert sum(planner.statistics.reasons.values()) == 5
    assert "holding the last plan" in caplog.text


@pytest.mark.parametrize("config", FORMS, ids=lambda c: f"{c.form}-{c.solver}")
def test_solves_again_after_a_failure(random_state, config, model):
    planner, fresh = make(model, config), make(model, config)
    state = random_state(model, 2)
    planner.plan(*state)
    planner.plan(state[0] * np.nan, *state[1:])
    np.testing.assert_allclose(planner.plan(*state), fresh.plan(*state), atol=1e-5)
    assert planner.statistics.failures == 1


@pytest.mark.filterwarnings("ignore:overflow|invalid value")
@pytest.mark.parametrize("config", FORMS, ids=lambda c: f"{c.form}-{c.solver}")
@pytest.mark.parametrize("size", [1e20, 1e60, 1e100, 1e200, -1e300])
def test_huge_numbers_are_a_failure_and_leave_nothing_behind(size, config, model):
    planner, fresh = make(model, config), make(model, config)
    action = np.zeros(1)
    rows, factor = model.linearise(np.array([0.1, 0.2, 0.3]), action)
    huge_rows, huge_factor = model.linearise(np.array([0.1, size, 0.3]), action)
    planner.plan(rows, factor, action)
    held = planner.planned[1] - planner.planned[0]
    increment = planner.plan(huge_rows, huge_factor, action)
    np.testing.assert_array_equal(increment, np.clip(held, -1.5, 1.5))
    assert planner.statistics.failures == 1
    assert planner.statistics.reasons.total() == 1
    expected = fresh.plan(rows, factor, action)
    np.testing.assert_allclose(planner.plan(rows, factor, action), expected, atol=1e-5)


@pytest.mark.filterwarnings("ignore:overflow|invalid value|divide by zero")
@pytest.mark.parametrize("config", EVERY, ids=lambda c: f"{c.method}-{c.linearisation}-{c.form}-{c.solver}")
def test_no_number_in_the_model_takes_an_action_beyond_the_limits(random_model, config):
    model = random_model(0, decoder=(6,))
    planner = make(model, config, 0.3)
    good = *model.linearise(np.array([0.1, 0.2, 0.3]), np.zeros(1)), np.zeros(1)

    @settings(max_examples=25, deadline=None)
    @given(
        arrays(float, (2, 6), elements=NUMBERS), arrays(float, (1, 6), elements=NUMBERS), st.floats(-0.3, 0.3)
    )
    @example(np.full((2, 6), 1e19), np.full((1, 6), 1e19), 0.3)
    def check(rows, factor, action):
        applied = np.array([action]) + planner.plan(rows, factor, np.array([action]))
        assert np.abs(applied).max() <= 0.3 + 1e-12

    check()
    failures = planner.statistics.failures
    planner.plan(*good)
    assert planner.statistics.failures == failures > 0


def test_the_settings_offer_what_the_registries_hold():
    assert set(CHOICES["method"]) == set(METHODS)
    assert set(CHOICES["form"]) == set(FROZEN_FORMS) == set(VARYING_FORMS)
    assert set(CHOICES["linearisation"]) == {"frozen"} | set(LINEARISATIONS)


def test_a_plan_that_is_not_finite_is_a_failure(random_state, model, monkeypatch):
    planner = make(model, PlannerConfig(5))
    state = random_state(model, 1)
    planner.plan(*state)
    monkeypatch.setattr(planner._program, "solve", lambda *_: np.full((5, 1), np.nan))
    assert np.isfinite(planner.plan(*state)).all()
    assert planner.statistics.reasons == {"the plan is not finite": 1}


def test_an_infeasible_problem_is_a_failure_not_an_exception(random_state, model):
    planner = make_planner(model, PlannerConfig(5), np.array([1.0]), np.array([-1.0]))
    assert np.isfinite(planner.plan(*random_state(model, 0))).all()
    assert planner.statistics.failures == 1


def test_an_iterative_solver_that_runs_out_of_steps_is_a_failure(random_state, model):
    planner = make(model, PlannerConfig(5, solver="osqp", tolerance=1e-300))
    planner.plan(*random_state(model, 3))
    assert planner.statistics.failures == 1


def test_reset_forgets_the_plan(random_state, model):
    planner = make(model, PlannerConfig(5))
    rows, factor, action = random_state(model, 1)
    planner.plan(rows, factor, action)
    planner.reset()
    assert planner.planned is None
    np.testing.assert_array_equal(planner.plan(rows * np.nan, factor, action), 0.0)


def test_the_plan_that_is_followed_moves_on_with_every_failure(random_state, model):
    planner = make(model, PlannerConfig(5))
    rows, factor, action = random_state(model, 1)
    increment = planner.plan(rows, factor, action)
    planned = planner.planned
    assert planned.shape == (5, 1)
    np.testing.assert_allclose(planned[0], action + increment)
    planner.plan(rows * np.nan, factor, action)
    np.testing.assert_array_equal(planner.planned, planned[[1, 2, 3, 4, 4]])


def test_bad_settings_are_named(model):
    with pytest.raises(PlannerConfigError, match="dense"):
        make(model, PlannerConfig(5, form="dense"))
    with pytest.raises(PlannerConfigError, match="horizon"):
        make(model, PlannerConfig(0))
    with pytest.raises(PlannerConfigError, match="increment_weight = -1"):
        make(model, PlannerConfig(5, increment_weight=-1.0))
    with pytest.raises(PlannerConfigError, match="tolerance"):
        make(model, PlannerConfig(5, tolerance=float("nan")))
    with pytest.raises(UnknownSolverError, match="daqp"):
        make(model, PlannerConfig(5, solver="nope"))
    with pytest.raises(PlannerConfigError, match='method = "mppi"; choose one of lmpc, cem'):
        make(model, PlannerConfig(5, method="mppi"))


def test_a_longer_horizon_does_not_change_the_meaning_of_the_weights(random_model, random_state):
    # With C = 0 only actions and increments cost: the best plan moves towards zero from a_0.
    model = random_model(0)
    rows, factor, action = random_state(model, 0)
    for config in FORMS:
        planner = make(model, dataclasses.replace(config, horizon=10))
        increment = planner.plan(rows, factor * 0.0, action)
        assert (increment * action < 0).all()
        assert (np.abs(increment) < np.abs(action)).all()

"""The controller keeps its promises when a program cannot be solved."""

import dataclasses

import numpy as np
import pytest

from deepkoco.planning import PlannerConfig, PlannerConfigError, SolverError, UnknownSolverError, make_planner
from deepkoco.planning.solvers.daqp_solver import DaqpBox

FORMS = [PlannerConfig(5), PlannerConfig(5, solver="osqp"), PlannerConfig(5, form="sparse", tolerance=1e-9)]


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
    held = planner._held[0].copy()
    increment = planner.plan(huge_rows, huge_factor, action)
    np.testing.assert_array_equal(increment, np.clip(held, -1.5, 1.5))
    assert planner.statistics.failures == 1
    assert planner.statistics.reasons.total() == 1
    expected = fresh.plan(rows, factor, action)
    np.testing.assert_allclose(planner.plan(rows, factor, action), expected, atol=1e-5)


def test_a_program_that_daqp_refuses_to_update_is_not_solved():
    solver = DaqpBox(-np.ones(2), np.ones(2), 1e-6)
    np.testing.assert_allclose(solver.solve(2.0 * np.eye(2), np.ones(2)), [-0.5, -0.5])
    with pytest.raises(SolverError, match="at update"):
        solver.solve(-np.eye(2), np.ones(2))
    np.testing.assert_allclose(solver.solve(4.0 * np.eye(2), np.ones(2)), [-0.25, -0.25])


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
    np.testing.assert_array_equal(planner.plan(rows * np.nan, factor, action), 0.0)


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


def test_a_longer_horizon_does_not_change_the_meaning_of_the_weights(random_model, random_state):
    # With C = 0 only actions and increments cost: the best plan moves towards zero from a_0.
    model = random_model(0)
    rows, factor, action = random_state(model, 0)
    for config in FORMS:
        planner = make(model, dataclasses.replace(config, horizon=10))
        increment = planner.plan(rows, factor * 0.0, action)
        assert (increment * action < 0).all()
        assert (np.abs(increment) < np.abs(action)).all()

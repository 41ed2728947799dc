"""Planning with B and C taken anew along the last plan."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.planning import PlannerConfig, PlannerConfigError, make_planner
from deepkoco.planning.along_plan import AlongPlan, relinearise_tangent
from deepkoco.planning.cem import CrossEntropyMethod
from deepkoco.planning.condensed import VaryingCondensedProgram
from deepkoco.planning.config import PlanningProblem

LIMIT = 1.5
ALONG = PlannerConfig(4, linearisation="along_plan")


def make(model, config=ALONG):
    bounds = np.full(model.action_size, LIMIT)
    return make_planner(model, config, -bounds, bounds)


@settings(max_examples=10, deadline=None)
@given(
    st.integers(0, 2**20), st.integers(1, 2), st.sampled_from(["along_plan", "cost_along_plan", "tangent"])
)
def test_a_model_with_the_same_b_and_c_everywhere_is_planned_as_frozen(
    steady_model, seed, actions, linearisation
):
    model = steady_model(seed, actions)
    along, frozen = make(model, replace(ALONG, linearisation=linearisation)), make(model, PlannerConfig(4))
    rng = np.random.default_rng(seed)
    action = np.zeros(actions)
    for _ in range(3):
        rows, factor = model.linearise(rng.normal(size=3), action)
        increment = along.plan(rows, factor, action)
        np.testing.assert_allclose(increment, frozen.plan(rows, factor, action), atol=1e-5)
        action = action + increment


@pytest.mark.parametrize("form", ["condensed", "sparse"])
def test_b_and_c_are_those_of_the_last_plan_moved_on_by_one_step(random_model, form):
    model = random_model(3, decoder=(6,))
    planner = make(model, replace(ALONG, form=form, tolerance=1e-9))
    rng = np.random.default_rng(0)
    action = np.zeros(1)
    rows, factor = model.linearise(rng.normal(size=3), action)
    action = action + planner.plan(rows, factor, action)
    last, last_inputs = planner._program._planned.copy(), planner._program._inputs.copy()
    rows, factor = model.linearise(rng.normal(size=3), action)
    planner.plan(rows, factor, action)

    nominal = [last[1], last[2], last[3], last[3]]
    roll_inputs = [rows[1:], last_inputs[2], last_inputs[3], last_inputs[3]]
    s, before, latents = rows[0], action, []
    for a, b in zip(nominal, roll_inputs, strict=True):
        s = model.dynamics.matrix @ s + (a - before) @ b
        latents.append(s)
        before = a
    inputs = [rows[1:]]
    for latent, a in zip(latents[:-1], nominal[:-1], strict=True):
        inputs.append(model.linearise(model.decode(latent), a)[0][1:])
    factors = [model.factor(latent) for latent in latents]
    limit = np.array([LIMIT])
    problem = PlanningProblem(model.dynamics, -limit, limit, model.action_weight, 0.01, 4)
    expected = VaryingCondensedProgram(problem, "daqp", 1e-9).solve_varying(
        rows[0], np.stack(inputs), np.stack(factors), action
    )
    np.testing.assert_allclose(planner._program._planned, expected, atol=1e-5)
    assert np.abs(np.diff(np.stack(inputs), axis=0)).max() > 1e-4  # B does vary


def test_the_cost_along_the_plan_alone_keeps_the_present_b(random_model):
    model = random_model(3)  # no decoder
    planner = make(model, replace(ALONG, linearisation="cost_along_plan"))
    rows, factor = model.linearise(np.array([0.1, 0.2, 0.3]), np.zeros(1))
    planner.plan(rows, factor, np.zeros(1))
    np.testing.assert_array_equal(planner._program._inputs, np.stack([rows[1:]] * 4))
    assert planner.statistics.failures == 0


def test_the_tangent_has_the_slope_of_the_predicted_cost_root(random_model):
    model = random_model(3, rank=2, decoder=(6,))
    rng = np.random.default_rng(0)
    latents, actions = rng.normal(size=(4, 6)), rng.normal(size=(4, 1))
    _, slope, offsets = relinearise_tangent(model)(latents, actions, np.zeros((1, 6)))
    for s, c, e in zip(latents, slope, offsets, strict=True):
        np.testing.assert_allclose(c @ s + e, model.factor(s) @ s, atol=1e-9)
        direction = 1e-5 * rng.normal(size=6)
        ahead, behind = (model.factor(x) @ x for x in (s + direction, s - direction))
        np.testing.assert_allclose(c @ direction * 2, ahead - behind, atol=1e-9)


def test_tangent_plans_settle_where_the_updated_model_costs_least(random_model):
    # Repeated at one state the plans converge, and no small change of the plan is better on the model itself.
    model = random_model(3, decoder=(6,))
    limit = np.array([LIMIT])
    problem = PlanningProblem(model.dynamics, -limit, limit, model.action_weight, 0.01, 4)
    rows, factor = model.linearise(np.array([0.1, 0.2, 0.3]), np.zeros(1))
    program = VaryingCondensedProgram(problem, "daqp", 1e-9)
    relinearise = relinearise_tangent(model)
    along = AlongPlan(model.dynamics, relinearise, program, 4)
    plan, inputs = np.zeros((4, 1)), np.stack([rows[1:]] * 4)
    for _ in range(20):
        latents = along._roll(rows[0], inputs, plan, np.zeros(1))
        following, factors, offsets = relinearise(latents, plan, rows[1:])
        inputs = np.concatenate((rows[None, 1:], following[:-1]))
        plan = program.solve_varying(rows[0], inputs, factors, np.zeros(1), offsets)
    config = PlannerConfig(4, method="cem", linearisation="tangent")
    exact = CrossEntropyMethod(model, problem, config, np.random.default_rng(0))
    exact.solve(rows, factor, np.zeros(1))
    nearby = np.clip(plan + 0.02 * np.random.default_rng(1).normal(size=(200, 4, 1)), -LIMIT, LIMIT)
    assert exact.objective(plan[None])[0] <= exact.objective(nearby).min() + 1e-6


def test_a_step_that_is_not_solved_is_held_and_leaves_nothing_behind(random_model):
    model = random_model(3, decoder=(6,))
    planner, fresh = make(model), make(model)
    rows, factor = model.linearise(np.array([0.1, 0.2, 0.3]), np.zeros(1))
    planner.plan(rows, factor, np.zeros(1))
    planner.plan(rows * np.nan, factor, np.zeros(1))
    assert planner.statistics.failures == 1
    expected = fresh.plan(rows, factor, np.zeros(1))
    np.testing.assert_allclose(planner.plan(rows, factor, np.zeros(1)), expected, atol=1e-9)


def test_a_model_without_decoder_is_refused_at_set_up(model):
    for method in ("lmpc", "cem"):
        with pytest.raises(PlannerConfigError, match=r"along_plan.*decoder"):
            make(model, replace(ALONG, method=method))

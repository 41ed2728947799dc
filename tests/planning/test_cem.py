"""The cross-entropy method against the quadratic program on a model for which both solve the same problem."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.planning import PlannerConfig, PlannerConfigError, make_planner
from deepkoco.planning.cem import CrossEntropyMethod
from deepkoco.planning.condensed import CondensedProgram
from deepkoco.planning.config import PlanningProblem

LIMIT = 1.5
CEM = PlannerConfig(3, method="cem")


def programs(model, config, seed=0):
    limit = np.full(model.action_size, LIMIT)
    problem = PlanningProblem(model.dynamics, -limit, limit, model.action_weight, 0.01, config.horizon)
    generator = np.random.default_rng(seed)
    return CrossEntropyMethod(model, problem, config, generator), CondensedProgram(problem, "daqp", 1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**20), st.integers(1, 2))
def test_cem_comes_close_to_the_optimum_and_never_below_it(steady_model, seed, actions):
    model = steady_model(seed, actions)
    cem, exact = programs(model, CEM)
    action = np.zeros(actions)
    state = *model.linearise(np.random.default_rng(seed).normal(size=3), action), action
    plan, optimum = cem.solve(*state), exact.solve(*state)
    assert np.abs(plan).max() <= LIMIT
    cost, lowest, resting = cem.objective(np.stack((plan, optimum, np.zeros_like(plan))))
    assert lowest - 1e-9 * (1 + lowest) <= cost
    assert cost - lowest <= 0.2 * (resting - lowest) + 1e-6


def test_the_objective_takes_the_cost_factor_of_every_predicted_latent(random_model, random_state):
    model = random_model(2)
    cem, _ = programs(model, replace(CEM, linearisation="cost_along_plan"))
    rows, factor, action = random_state(model, 1)
    cem.solve(rows, factor, action)
    plan = np.array([[0.5], [-1.0], [1.5]])
    s, before, cost, expected = rows[0], action, 0.0, 0.0
    for a in plan:
        s = model.dynamics.matrix @ s + (a - before) @ rows[1:]
        cost += (model.factor(s) @ s).item() ** 2 + model.action_weight * a.item() ** 2
        expected += 0.01 * (a - before).item() ** 2
        before = a
    assert cem.planned_cost(plan) == pytest.approx(cost)
    assert cem.objective(plan[None]).item() == pytest.approx(cost + expected)


def test_frozen_samples_solve_the_problem_of_the_quadratic_program(random_model, random_state):
    model = random_model(2)
    cem, exact = programs(model, CEM)
    state = random_state(model, 1)
    cem.solve(*state)
    optimum = exact.solve(*state)
    assert cem.planned_cost(optimum) == pytest.approx(exact.planned_cost(optimum))


def test_samples_with_a_decoder_take_b_at_their_own_latents(random_model, random_state):
    model = random_model(2, decoder=(6,))
    cem, _ = programs(model, replace(CEM, linearisation="along_plan"))
    rows, factor, action = random_state(model, 1)
    cem.solve(rows, factor, action)
    plan = np.array([[0.5], [-1.0], [1.5]])
    s, before, b, cost = rows[0], action, rows[1:], 0.0
    for a in plan:
        s = model.dynamics.matrix @ s + (a - before) @ b
        cost += (model.factor(s) @ s).item() ** 2 + model.action_weight * a.item() ** 2
        b, before = model.linearise_along(s, a)[0], a
    assert cem.planned_cost(plan) == pytest.approx(cost)


def test_the_seed_decides_the_plan(random_model, random_state):
    model = random_model(2)
    limit, state = np.array([LIMIT]), random_state(model, 1)
    first, again, other = (make_planner(model, CEM, -limit, limit, seed).plan(*state) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.filterwarnings("ignore:overflow|invalid value")
@pytest.mark.parametrize("size", [np.nan, np.inf, 1e200])
def test_numbers_that_are_not_finite_are_a_failure(model, random_state, size):
    limit = np.array([LIMIT])
    planner = make_planner(model, CEM, -limit, limit)
    rows, factor, action = random_state(model, 1)
    assert np.isfinite(planner.plan(rows * size, factor, action)).all()
    assert planner.statistics.failures == 1
    planner.plan(rows, factor, action)
    assert planner.statistics.failures == 1


def test_more_elites_than_samples_are_refused():
    with pytest.raises(PlannerConfigError, match="elites = 50"):
        PlannerConfig(method="cem", samples=20).check()

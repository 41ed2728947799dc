"""Both forms of the planning problem against a brute-force solution and each other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from deepkoco.koopman import ExportedModel
from deepkoco.koopman.latent_model import DenseTransition, JordanBlocks
from deepkoco.planning import SolverError
from deepkoco.planning.condensed import CondensedProgram
from deepkoco.planning.config import PlanningProblem
from deepkoco.planning.solvers.qpsolvers_solver import QpsolversBox
from deepkoco.planning.sparse import SparseProgram

LIMIT = 1.5


def make_problem(model: ExportedModel, horizon: int, action_weight: float = 0.001) -> PlanningProblem:
    limit = np.full(model.action_size, LIMIT)
    return PlanningProblem(model.dynamics, -limit, limit, action_weight, 0.01, horizon)


def residuals(model, problem, rows, factor, action, planned):
    """Square roots of all terms of the objective, by running the latent model forward."""
    angle, growth = np.angle(model.eigenvalues), np.abs(model.eigenvalues)
    s, before, terms = rows[0], action, []
    for a in planned.reshape(problem.horizon, -1):
        pairs = s.reshape(-1, 2)
        turned = np.stack(
            (
                growth * (np.cos(angle) * pairs[:, 0] - np.sin(angle) * pairs[:, 1]),
                growth * (np.sin(angle) * pairs[:, 0] + np.cos(angle) * pairs[:, 1]),
            ),
            axis=1,
        )
        s = turned.ravel() + (a - before) @ rows[1:]
        terms += [factor @ s, problem.action_weight**0.5 * a, problem.increment_weight**0.5 * (a - before)]
        before = a
    return np.concatenate(terms)


def brute_force(model, problem, rows, factor, action):
    """The affine residuals, probed column by column, in a general bounded least-squares solver."""
    size = problem.horizon * action.size
    offset = residuals(model, problem, rows, factor, action, np.zeros(size))
    columns = [residuals(model, problem, rows, factor, action, unit) - offset for unit in np.eye(size)]
    return lsq_linear(np.stack(columns, 1), -offset, (-LIMIT, LIMIT), method="bvls", tol=1e-14).x


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**20), actions=st.integers(1, 2), horizon=st.integers(1, 6))
def test_condensed_form_equals_bounded_least_squares(random_model, random_state, seed, actions, horizon):
    model = random_model(seed, actions=actions)
    problem = make_problem(model, horizon)
    state = random_state(model, seed)
    planned = CondensedProgram(problem, "daqp", 1e-6).solve(*state)
    np.testing.assert_allclose(planned.ravel(), brute_force(model, problem, *state), atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**20), actions=st.integers(1, 2))
def test_sparse_form_gives_the_condensed_answer_step_after_step(random_model, random_state, seed, actions):
    model = random_model(seed, actions=actions)
    problem = make_problem(model, 6)
    condensed, sparse = CondensedProgram(problem, "daqp", 1e-6), SparseProgram(problem, "osqp", 1e-8)
    for step in range(3):  # the second and third run through the updates
        state = random_state(model, seed + step)
        np.testing.assert_allclose(sparse.solve(*state), condensed.solve(*state), atol=2e-4)


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
def test_backends_give_the_brute_force_answer_after_updates(random_state, solver, model):
    problem = make_problem(model, 5)
    program = CondensedProgram(problem, solver, 1e-8)
    for seed in range(4):
        state = random_state(model, seed)
        np.testing.assert_allclose(
            program.solve(*state).ravel(), brute_force(model, problem, *state), atol=1e-4
        )


@pytest.mark.filterwarnings("ignore:Converted matrix:UserWarning", "ignore:The default value of raise_error")
def test_a_solver_that_is_made_anew_gives_the_brute_force_answer(random_state, model):
    problem = make_problem(model, 5)
    program = CondensedProgram(problem, "daqp", 1e-8)
    solver = QpsolversBox("osqp", np.full(5, -LIMIT), np.full(5, LIMIT))
    for seed in range(4):
        state = random_state(model, seed)
        expected = brute_force(model, problem, *state)
        np.testing.assert_allclose(solver.solve(*program.matrices(*state)), expected, atol=5e-3)


@pytest.mark.filterwarnings("ignore:Converted matrix:UserWarning", "ignore:The default value of raise_error")
def test_what_another_solver_raises_is_a_solver_error():
    solver = QpsolversBox("osqp", -np.ones(2), np.ones(2))
    with pytest.raises(SolverError, match="osqp"):
        solver.solve(np.diag([-1.0, 1.0]), np.ones(2))
    with pytest.raises(SolverError, match="not finite"):
        solver.solve(np.full((2, 2), np.nan), np.ones(2))


def test_one_step_by_hand():
    # P = 1, Lambda = 1, s = (3, 0), B = (2, 0), C = (1, 0), a_0 = 0.5, R = 0, R~ = 0.01:
    # min (3 + 2 d)^2 + 0.01 d^2 -> d = -6 / 4.01, within the limits: a_1 = 0.5 - 6 / 4.01
    problem = PlanningProblem(
        JordanBlocks(np.ones(1, complex)), np.array([-1.5]), np.array([1.5]), 0.0, 0.01, 1
    )
    rows = np.array([[3.0, 0.0], [2.0, 0.0]])
    for program in (CondensedProgram(problem, "daqp", 1e-6), SparseProgram(problem, "osqp", 1e-9)):
        planned = program.solve(rows, np.array([[1.0, 0.0]]), np.array([0.5]))
        assert planned[0, 0] == pytest.approx(0.5 - 6 / 4.01, abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**20), actions=st.integers(1, 2))
def test_jordan_blocks_written_as_a_dense_matrix_give_the_same_plan(
    random_model, random_state, seed, actions
):
    model = random_model(seed, actions=actions)
    jordan = make_problem(model, 6)
    dense = replace(jordan, dynamics=DenseTransition(model.dynamics.matrix))
    state = random_state(model, seed)
    expected = CondensedProgram(jordan, "daqp", 1e-6).solve(*state)
    np.testing.assert_allclose(CondensedProgram(dense, "daqp", 1e-6).solve(*state), expected, atol=1e-8)
    np.testing.assert_allclose(SparseProgram(dense, "osqp", 1e-8).solve(*state), expected, atol=2e-4)


def test_a_model_that_takes_the_action_itself_is_a_dense_transition():
    # z' = z + u with u the action itself: latent (z, a), a' = a + da, so z' = z + a + da.
    # One step from z = 3, a_0 = 0: min (3 + d)^2 + 0.01 d^2 -> d = -3 / 1.01, beyond the limit of -1.5.
    dynamics = DenseTransition(np.array([[1.0, 1.0], [0.0, 1.0]]))
    problem = PlanningProblem(dynamics, np.array([-1.5]), np.array([1.5]), 0.0, 0.01, 1)
    state = np.array([[3.0, 0.0], [1.0, 1.0]]), np.array([[1.0, 0.0]]), np.zeros(1)
    for program in (CondensedProgram(problem, "daqp", 1e-6), SparseProgram(problem, "osqp", 1e-9)):
        assert program.solve(*state)[0, 0] == pytest.approx(-1.5, abs=1e-6)

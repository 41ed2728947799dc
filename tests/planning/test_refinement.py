"""The exact optimum of a plan, against scipy's bounded least squares and by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from deepkoco.koopman.latent_model import JordanBlocks
from deepkoco.planning.box_program import BoxProgram
from deepkoco.planning.config import PlanningProblem
from deepkoco.planning.errors import SolverError
from deepkoco.planning.refinement import bounded_least_squares


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, 2**20),
    st.integers(1, 20),
    st.floats(0.0, 5.0),
    st.sampled_from(["zero", "limits", "drawn"]),
)
def test_bounded_least_squares_agrees_with_scipy_from_any_start(seed, size, decades, kind):
    rng = np.random.default_rng(seed)
    left, _ = np.linalg.qr(rng.normal(size=(size + 5, size)))
    right, _ = np.linalg.qr(rng.normal(size=(size, size)))
    matrix = left * np.logspace(0.0, -decades, size) @ right
    target = matrix @ rng.normal(size=size) * 2.0 + 0.1 * rng.normal(size=size + 5)
    low, high = -np.ones(size), rng.uniform(0.1, 2.0, size)
    start = {"zero": np.zeros(size), "limits": np.where(rng.random(size) < 0.5, low, high)}.get(
        kind, rng.normal(size=size) * 3.0
    )
    found = bounded_least_squares(matrix, target, low, high, start, np.full(size, 1e-9))
    expected = lsq_linear(matrix, target, (low, high), method="bvls", tol=1e-15, max_iter=5000)
    assert (found >= low).all()
    assert (found <= high).all()
    np.testing.assert_allclose(
        np.linalg.norm(matrix @ found - target), np.linalg.norm(expected.fun), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(found, expected.x, atol=1e-12 * 10.0 ** (2.0 * decades) + 1e-9)


def test_a_singular_problem_is_refused():
    matrix = np.diag([1.0, 0.0])
    with pytest.raises(SolverError, match="not unique"):
        bounded_least_squares(matrix, np.ones(2), -np.ones(2), np.ones(2), np.full(2, 0.5), np.zeros(2))


def test_a_plan_off_by_less_than_the_precision_is_let_pass_and_one_off_by_more_is_not():
    # H = M = 1, D = 0, R = 1, R~ = 0: min x^2, so mu = 2, x* = 0 and |v| / mu = |x|. Range 2: 2e-4 may pass.
    problem = PlanningProblem(JordanBlocks(np.ones(1, complex)), -np.ones(1), np.ones(1), 1.0, 0.0, 1)
    refinement = BoxProgram(problem, "daqp", 1e-6)._refinement
    rest = np.zeros((1, 1)), np.zeros(1), np.zeros(1)
    assert refinement.is_close(np.array([1.9e-4]), *rest)
    assert not refinement.is_close(np.array([2.1e-4]), *rest)
    np.testing.assert_allclose(refinement.solve(np.array([0.5]), *rest), [0.0], atol=1e-15)


def test_a_gradient_that_pushes_against_a_limit_is_no_error():
    # min (x + 3)^2 + x^2 in [-1, 1]: x* = -1 with gradient 2 (x + 3) + 2 x = 2.
    problem = PlanningProblem(JordanBlocks(np.ones(1, complex)), -np.ones(1), np.ones(1), 1.0, 0.0, 1)
    refinement = BoxProgram(problem, "daqp", 1e-6)._refinement
    rest = np.ones((1, 1)), np.array([3.0]), np.zeros(1)
    assert refinement.is_close(np.array([-1.0]), *rest)
    assert not refinement.is_close(np.array([1.0]), *rest)
    assert refinement.solve(np.array([1.0]), *rest) == pytest.approx(-1.0)


def unweighted(low, high, horizon=1):
    limits = np.full(1, low), np.full(1, high)
    problem = PlanningProblem(JordanBlocks(np.ones(1, complex)), *limits, 0.0, 0.0, horizon)
    return BoxProgram(problem, "daqp", 1e-6)._refinement


def test_without_weights_a_plan_is_let_pass_by_its_cost():
    # R = R~ = 0, D = 1, y_0 = 0.5 in [-1, 1]: f = (x + 0.5)^2, x* = -0.5. At x = -0.5 + e the slope is 2 e > 0, so the
    # excess is bounded by 2 e (0.5 + e); 1e-6 |y_0|^2 = 2.5e-7 may pass.
    refinement = unweighted(-1.0, 1.0)
    rest = np.ones((1, 1)), np.array([0.5]), np.zeros(1)
    assert refinement.is_close(np.array([-0.5 + 2.4e-7]), *rest)
    assert not refinement.is_close(np.array([-0.5 + 2.6e-7]), *rest)
    assert not refinement.is_close(np.array([1.1]), *rest)
    assert refinement.solve(np.array([1.0]), *rest) == pytest.approx(-0.5)


def test_without_weights_and_limits_only_an_optimum_is_let_pass():
    refinement = unweighted(-np.inf, np.inf)
    rest = np.ones((1, 1)), np.array([0.5]), np.zeros(1)
    assert refinement.is_close(np.array([-0.5]), *rest)
    assert not refinement.is_close(np.array([-0.5 + 1e-9]), *rest)


def test_without_weights_one_of_several_optima_is_found():
    # f = (x_1 + x_2 - 1)^2 is lowest on a line.
    refinement = unweighted(-1.0, 1.0, horizon=2)
    rest = np.ones((1, 2)), np.array([-1.0]), np.zeros(1)
    assert refinement.is_close(np.array([0.3, 0.7]), *rest)
    assert refinement.is_close(np.array([1.0, 0.0]), *rest)
    assert not refinement.is_close(np.array([0.3, 0.5]), *rest)
    assert refinement.solve(np.array([0.3, 0.5]), *rest).sum() == pytest.approx(1.0)

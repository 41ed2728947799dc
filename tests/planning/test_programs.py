"""Every form of the planning problem against a general solver and each other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from deepkoco.koopman import ExportedModel
from deepkoco.koopman.latent_model import DenseTransition, JordanBlocks
from deepkoco.planning.condensed import CondensedProgram, VaryingCondensedProgram
from deepkoco.planning.config import PlanningProblem
from deepkoco.planning.solvers import solver_names
from deepkoco.planning.sparse import SparseProgram

LIMIT = 1.5
SEEDS = st.integers(0, 2**20)
KINDS = st.sampled_from(["jordan", "dense"])


def make_problem(model: ExportedModel, horizon: int, dynamics=None, action_weight=0.001) -> PlanningProblem:
    limit = np.full(model.action_size, LIMIT)
    dynamics = model.dynamics if dynamics is None else dynamics
    return PlanningProblem(dynamics, -limit, limit, action_weight, 0.01, horizon, model.cost_rank)


def residuals(problem, latent, inputs, factors, offsets, action, planned):
    """Square roots of all terms of the objective, by running the latent model forward."""
    s, before, terms = latent, action, []
    for k, a in enumerate(planned.reshape(problem.horizon, -1)):
        s = problem.dynamics.matrix @ s + (a - before) @ inputs[k]
        terms += [
            factors[k] @ s + offsets[k],
            problem.action_weight**0.5 * a,
            problem.increment_weight**0.5 * (a - before),
        ]
        before = a
    return np.concatenate(terms)


def brute_force_varying(problem, latent, inputs, factors, offsets, action):
    """The affine residuals, probed column by column, in a general bounded least-squares solver."""
    size = problem.horizon * action.size
    arguments = problem, latent, inputs, factors, offsets, action
    offset = residuals(*arguments, np.zeros(size))
    columns = [residuals(*arguments, unit) - offset for unit in np.eye(size)]
    matrix = np.stack(columns, 1)
    found = lsq_linear(matrix, -offset, (-LIMIT, LIMIT), method="bvls", tol=1e-14, max_iter=1000)
    assert found.success, found.message
    return found.x


def brute_force(problem, rows, factor, action):
    steps = problem.horizon
    inputs, factors = np.stack([rows[1:]] * steps), np.stack([factor] * steps)
    return brute_force_varying(problem, rows[0], inputs, factors, np.zeros((steps, 1)), action)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(1, 2), st.integers(1, 3), st.integers(1, 6), KINDS)
def test_condensed_form_equals_bounded_least_squares(
    random_model, random_state, random_dynamics, seed, actions, rank, horizon, kind
):
    model = random_model(seed, actions=actions, rank=rank)
    problem = make_problem(model, horizon, random_dynamics(model, seed, kind))
    state = random_state(model, seed)
    planned = CondensedProgram(problem, "daqp", 1e-6).solve(*state)
    np.testing.assert_allclose(planned.ravel(), brute_force(problem, *state), atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 2), st.integers(1, 3), KINDS)
def test_sparse_form_gives_the_condensed_answer_step_after_step(
    random_model, random_state, random_dynamics, seed, actions, rank, kind
):
    model = random_model(seed, actions=actions, rank=rank)
    problem = make_problem(model, 6, random_dynamics(model, seed, kind))
    condensed, sparse = CondensedProgram(problem, "daqp", 1e-6), SparseProgram(problem, "osqp", 1e-8)
    for step in range(3):  # the second and third run through the updates
        state = random_state(model, seed + step)
        np.testing.assert_allclose(sparse.solve(*state), condensed.solve(*state), atol=2e-4)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 2), st.integers(1, 3), st.integers(1, 5), KINDS)
@example(496309, 2, 2, 5, "jordan")  # bounded least squares needs more iterations than it takes by itself
def test_varying_b_and_c_equal_bounded_least_squares(
    random_model, random_state, random_dynamics, seed, actions, rank, horizon, kind
):
    model = random_model(seed, actions=actions, rank=rank)
    problem = make_problem(model, horizon, random_dynamics(model, seed, kind))
    rows, factor, action = random_state(model, seed)
    rng = np.random.default_rng(seed)
    inputs = rows[1:] * rng.uniform(-1.0, 2.0, (horizon, *rows[1:].shape))
    factors = factor * rng.uniform(-1.0, 2.0, (horizon, *factor.shape))
    offsets = rng.normal(size=(horizon, rank))
    expected = brute_force_varying(problem, rows[0], inputs, factors, offsets, action)
    varying, sparse = VaryingCondensedProgram(problem, "daqp", 1e-6), SparseProgram(problem, "osqp", 1e-8)
    planned = varying.solve_varying(rows[0], inputs, factors, action, offsets)
    np.testing.assert_allclose(planned.ravel(), expected, atol=1e-6)
    planned = sparse.solve_varying(rows[0], inputs, factors, action, offsets)
    np.testing.assert_allclose(planned.ravel(), expected, atol=2e-4)


def test_limits_are_active_in_these_problems(random_model, random_state):
    # Else the tests above would say nothing about them.
    active = 0
    for seed in range(20):
        model = random_model(seed)
        planned = CondensedProgram(make_problem(model, 6), "daqp", 1e-6).solve(*random_state(model, seed))
        active += (np.abs(planned) == LIMIT).any()
    assert 5 <= active < 20


@pytest.mark.filterwarnings("ignore:Converted matrix:UserWarning", "ignore:The default value of raise_error")
@pytest.mark.parametrize(
    ("form", "solver"), [(form, s) for form in ("condensed", "sparse") for s in solver_names(form)]
)
@pytest.mark.parametrize("warm_start", ["kept", "shifted", "none"])
def test_every_solver_gives_the_brute_force_answer_after_updates(
    random_model, random_state, form, solver, warm_start
):
    model = random_model(0, actions=2)
    problem = make_problem(model, 5)
    program = {"condensed": CondensedProgram, "sparse": SparseProgram}[form]
    program = program(problem, solver, 1e-8, warm_start)
    for seed in range(4):
        state = random_state(model, seed)
        if seed == 2:
            program.reset()
        np.testing.assert_allclose(program.solve(*state).ravel(), brute_force(problem, *state), atol=2e-4)


@pytest.mark.parametrize(
    ("form", "solver"),
    [
        (CondensedProgram, "osqp"),
        (CondensedProgram, "daqp"),
        (CondensedProgram, "piqp"),
        (SparseProgram, "osqp"),
        (SparseProgram, "piqp"),
    ],
)
def test_iterations_are_those_of_the_last_solve_alone(random_model, random_state, form, solver):
    if solver not in solver_names("condensed"):
        pytest.skip(f"{solver} is not installed")
    model = random_model(0, actions=2)
    problem = make_problem(model, 5)
    used = form(problem, solver, 1e-8, "none")
    counts = set()
    for seed in range(8):
        state, new = random_state(model, seed), form(problem, solver, 1e-8, "none")
        used.solve(*state)
        new.solve(*state)
        assert used.iterations == new.iterations > 0
        counts.add(used.iterations)
    assert len(counts) > 1


@settings(max_examples=60, deadline=None)
@given(
    SEEDS,
    st.floats(0.0, 3.0),
    st.integers(1, 2),
    st.integers(2, 13),
    st.sampled_from(
        [name for name in ("osqp", "piqp", "clarabel", "daqp") if name in solver_names("condensed")]
    ),
)
@example(1, 2.0, 2, 13, "osqp")
def test_condensed_plans_are_precise_whatever_the_condition(
    random_model, random_state, seed, magnitude, actions, horizon, solver
):
    # B times 1 to 1,000: condition numbers of about 3 to 1e11.
    model = random_model(seed, actions=actions)
    problem = make_problem(model, horizon)
    rows, factor, action = random_state(model, seed)
    rows[1:] *= 10.0**magnitude
    planned = CondensedProgram(problem, solver, 1e-6).solve(rows, factor, action)
    expected = brute_force(problem, rows, factor, action)
    np.testing.assert_allclose(planned.ravel(), expected, atol=1e-4 * 2.0 * LIMIT)


@settings(max_examples=40, deadline=None)
@given(
    SEEDS,
    st.floats(0.0, 4.0),
    st.integers(1, 2),
    st.integers(1, 10),
    st.sampled_from([name for name in ("osqp", "piqp", "daqp") if name in solver_names("condensed")]),
)
@example(1, 2.0, 2, 8, "osqp")
def test_condensed_plans_without_weights_have_the_lowest_cost(
    random_model, random_state, seed, magnitude, actions, horizon, solver
):
    # With two actions and one row of cost, many plans are optimal.
    model = random_model(seed, actions=actions)
    problem = replace(make_problem(model, horizon, action_weight=0.0), increment_weight=0.0)
    rows, factor, action = random_state(model, seed)
    rows[1:] *= 10.0**magnitude
    program = CondensedProgram(problem, solver, 1e-3)  # osqp and piqp stop early
    matrix, free = program.response(rows, factor, action)
    lowest = 2.0 * lsq_linear(matrix, -free, (-LIMIT, LIMIT), method="bvls", tol=1e-14, max_iter=1000).cost
    planned = program.solve(rows, factor, action)
    assert program.planned_cost(planned) - lowest <= 1.01e-6 * float(free @ free)


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
def test_ill_conditioned_plans_are_refined_and_tell_so(random_model, random_state, solver):
    refined = {}
    for scale in (1.0, 1e4):
        refined[scale] = 0
        for seed in range(8):
            model = random_model(seed, actions=2, pairs=4)
            rows, factor, action = random_state(model, seed)
            rows[1:] *= scale
            program = CondensedProgram(make_problem(model, 13), solver, 1e-6)
            program.solve(rows, factor, action)
            refined[scale] += program.refined
    assert refined[1e4] >= 6
    assert solver == "osqp" or refined[1.0] == 0


@pytest.mark.parametrize("form", [CondensedProgram, SparseProgram])
def test_a_reset_program_plans_as_a_new_one(random_state, model, form):
    problem = make_problem(model, 5)
    used, new = form(problem, "osqp", 1e-4), form(problem, "osqp", 1e-4)
    for seed in range(5):
        used.solve(*random_state(model, seed))
    used.reset()
    state = random_state(model, 9)
    np.testing.assert_allclose(used.solve(*state), new.solve(*state), atol=1e-12)
    assert used.iterations == new.iterations


def test_going_on_from_the_last_solution_saves_iterations(random_state, model):
    problem, state = make_problem(model, 13), random_state(model, 1)
    iterations = {}
    for warm_start in ("kept", "none"):
        program = CondensedProgram(problem, "osqp", 1e-6, warm_start)
        program.solve(*state)
        program.solve(state[0] * 1.001, *state[1:])
        iterations[warm_start] = program.iterations
    assert iterations["kept"] < iterations["none"]


@settings(max_examples=15, deadline=None)
@given(SEEDS, st.integers(1, 2))
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


@pytest.mark.parametrize("form", [CondensedProgram, SparseProgram])
def test_planned_cost_and_conditioning_of_the_last_problem(random_state, model, form):
    problem = make_problem(model, 5)
    rows, factor, action = random_state(model, 3)
    program = form(problem, "auto", 1e-9)
    planned = program.solve(rows, factor, action)
    terms = residuals(problem, rows[0], [rows[1:]] * 5, [factor] * 5, np.zeros(5), action, planned.ravel())
    increments = np.diff(planned, axis=0, prepend=action[None])
    expected = terms @ terms - problem.increment_weight * (increments**2).sum()
    assert program.planned_cost(planned) == pytest.approx(expected, rel=1e-4)
    if form is SparseProgram:
        assert np.isnan(program.conditioning())
    else:
        condition = np.linalg.cond(program.matrices(rows, factor, action)[0], 1)
        assert condition / 3 <= program.conditioning() <= condition * (1 + 1e-9)


def test_one_step_by_hand():
    # P = 1, Lambda = 1, s = (3, 0), B = (2, 0), C = (1, 0), a_0 = 0.5, R = 0, R~ = 0.01:
    # min (3 + 2 d)^2 + 0.01 d^2 -> d = -6 / 4.01, within the limits: a_1 = 0.5 - 6 / 4.01
    dynamics = JordanBlocks(np.ones(1, complex))
    problem = PlanningProblem(dynamics, np.array([-1.5]), np.array([1.5]), 0.0, 0.01, 1)
    rows = np.array([[3.0, 0.0], [2.0, 0.0]])
    for program in (CondensedProgram(problem, "daqp", 1e-6), SparseProgram(problem, "osqp", 1e-9)):
        planned = program.solve(rows, np.array([[1.0, 0.0]]), np.array([0.5]))
        assert planned[0, 0] == pytest.approx(0.5 - 6 / 4.01, abs=1e-6)


def test_a_model_that_takes_the_action_itself_is_a_dense_transition():
    # z' = z + u with u the action itself: latent (z, a), a' = a + da, so z' = z + a + da.
    # One step from z = 3, a_0 = 0: min (3 + d)^2 + 0.01 d^2 -> d = -3 / 1.01, beyond the limit of -1.5.
    dynamics = DenseTransition(np.array([[1.0, 1.0], [0.0, 1.0]]))
    problem = PlanningProblem(dynamics, np.array([-1.5]), np.array([1.5]), 0.0, 0.01, 1)
    state = np.array([[3.0, 0.0], [1.0, 1.0]]), np.array([[1.0, 0.0]]), np.zeros(1)
    for program in (CondensedProgram(problem, "daqp", 1e-6), SparseProgram(problem, "osqp", 1e-9)):
        assert program.solve(*state)[0, 0] == pytest.approx(-1.5, abs=1e-6)


@pytest.mark.parametrize("form", [CondensedProgram, SparseProgram])
def test_every_action_may_have_weights_of_its_own(random_model, random_state, form):
    model = random_model(3, actions=2)
    problem = make_problem(model, 4, action_weight=np.array([0.001, 2.0]))
    problem = replace(problem, increment_weight=np.array([0.5, 0.01]))
    state = random_state(model, 3)
    planned = form(problem, "osqp" if form is SparseProgram else "daqp", 1e-9).solve(*state)
    np.testing.assert_allclose(planned.ravel(), brute_force(problem, *state), atol=1e-4)

"""EDMDc on systems whose answer is known, and control with it against Riccati's answer."""

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from deepkoco.koopman.lifting.edmdc import TargetCost, fit_edmdc, fit_lifted_cost
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, LiftedModelError, target_cost
from deepkoco.koopman.lifting.lifting import FunctionLifting, Identity, Polynomial, TimeDelays
from deepkoco.planning import PlannerConfig, make_planner

MATRIX = np.array([[1.0, 0.1], [0.3, 1.02]])  # unstable
INPUTS = np.array([[0.005], [0.1]])


def simulate(step, start, actions):
    """Observations o_0 .. o_{T-1} of a system under actions."""
    states = [start]
    for action in actions[:-1]:
        states.append(step(states[-1], action))
    return np.array(states)


def linear_step(x, a):
    return MATRIX @ x + INPUTS @ a


def random_episodes(step, seed, count=6, steps=30):
    rng = np.random.default_rng(seed)
    actions = rng.normal(size=(count, steps, 1))
    return np.stack([simulate(step, rng.normal(size=2), a) for a in actions]), actions


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**20))
def test_a_linear_system_is_found_exactly(seed):
    model = fit_edmdc(*random_episodes(linear_step, seed), Identity(2), TargetCost([1, 1], [0, 0], 0.1), 0.1)
    np.testing.assert_allclose(model.transition, MATRIX, atol=1e-9)
    np.testing.assert_allclose(model.inputs, INPUTS, atol=1e-9)


def test_a_system_with_a_finite_koopman_form_is_found_exactly():
    # x' = 0.9 x, y' = 0.8 y + 0.3 x^2 + a: linear in (x, y, x^2), with eigenvalues 0.9, 0.8 and 0.81.
    def step(x, a):
        return np.array([0.9 * x[0], 0.8 * x[1] + 0.3 * x[0] ** 2 + a[0]])

    lifting = FunctionLifting(lambda o: np.stack((o[..., 0], o[..., 1], o[..., 0] ** 2), -1), 2, 3)
    model = fit_edmdc(*random_episodes(step, 3), lifting, TargetCost([1, 1], [0, 0], 0.1), 0.1)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(model.transition)), [0.8, 0.81, 0.9], atol=1e-9)
    np.testing.assert_allclose(model.inputs.ravel(), [0, 1, 0], atol=1e-9)


def test_velocities_are_recovered_from_delayed_positions():
    observations, actions = random_episodes(lambda x, a: MATRIX @ x, 1)
    cost = TargetCost([1.0], [0.0], 0.1)
    model = fit_edmdc(observations[..., :1], 0.0 * actions, TimeDelays(1, delays=1), cost, 0.1)
    expected = np.linalg.eigvals(MATRIX)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(model.transition)), np.sort(expected), atol=1e-8)


def test_the_cost_in_the_latent_is_the_users_cost():
    rng = np.random.default_rng(0)
    weights = np.array([[2.0, 0.5], [0.5, 1.0]])
    cost = target_cost(np.eye(2), weights, [0.3, -1.0], 0.2)
    model = LiftedLinearModel(Identity(2), MATRIX, INPUTS, cost, 0.1)
    o, a = rng.normal(size=(5, 2)), rng.normal(size=(5, 1))
    rows, factor = model.linearise(o, a)
    ours = np.square((factor @ rows[:, 0, :, None])[..., 0]).sum(-1) + 0.2 * a[:, 0] ** 2
    error = o - [0.3, -1.0]
    np.testing.assert_allclose(ours, np.einsum("ki,ij,kj->k", error, weights, error) + 0.2 * a[:, 0] ** 2)
    np.testing.assert_allclose(cost(o, a), ours)


def test_one_step_of_the_latent_is_one_step_of_the_system():
    cost = target_cost(np.eye(2), [1, 1], [0, 0], 0.1)
    model = LiftedLinearModel(Identity(2), MATRIX, INPUTS, cost, 0.1)
    x, a, da = np.array([0.3, -0.2]), np.array([0.7]), np.array([-0.4])
    rows, _ = model.linearise(x, a)
    following = model.dynamics.advance(rows[0]) + da @ rows[1:]
    np.testing.assert_allclose(following, [*linear_step(x, a), *(a + da), 1.0])


def riccati_gain(increment_weight, action_weight):
    """K of da = -K (x, a) for the infinite horizon, by scipy on the system of state and action."""
    a = np.block([[MATRIX, INPUTS], [np.zeros((1, 2)), np.ones((1, 1))]])
    b = np.array([[0.0], [0.0], [1.0]])
    q = np.diag([1.0, 1.0, action_weight])
    r = np.array([[increment_weight]])
    p = solve_discrete_are(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a), (a, b, q, r)


def finite_horizon_gain(horizon, a, b, q, r):
    """The first gain of the finite horizon, by Riccati's recursion."""
    p = q
    for _ in range(horizon):
        gain = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
        p = q + a.T @ p @ (a - b @ gain)
    return gain


@pytest.mark.parametrize("horizon", [3, 10, 40])
def test_plans_without_active_limits_are_those_of_the_regulator(horizon):
    model = fit_edmdc(*random_episodes(linear_step, 2), Identity(2), TargetCost([1, 1], [0, 0], 0.1), 0.1)
    planner = make_planner(model, PlannerConfig(horizon, 0.05), np.array([-1e6]), np.array([1e6]))
    infinite, system = riccati_gain(0.05, 0.1)
    gain = finite_horizon_gain(horizon, *system)
    if horizon == 40:
        np.testing.assert_allclose(gain, infinite, rtol=1e-3)
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, a = rng.normal(size=2), rng.normal(size=1)
        rows, factor = model.linearise(x, a)
        expected = -gain @ np.concatenate((x, a))
        np.testing.assert_allclose(planner.plan(rows, factor, a), expected, rtol=1e-4, atol=1e-6)


def test_an_unstable_system_is_driven_to_a_target_within_the_limits():
    target = np.array([0.5, 0.0])
    cost = TargetCost([1, 0.1], target, 0.0)
    model = fit_edmdc(*random_episodes(linear_step, 2), Identity(2), cost, 0.1)
    planner = make_planner(model, PlannerConfig(25, 0.001), np.array([-3.0]), np.array([3.0]))
    x, a = np.array([-0.5, 0.0]), np.zeros(1)
    for _ in range(80):
        rows, factor = model.linearise(x, a)
        following = a + planner.plan(rows, factor, a)
        x, a = linear_step(x, a), following
        assert abs(a[0]) <= 3.0
    assert planner.statistics.failures == 0
    assert abs(x[0] - 0.5) < 0.01
    np.testing.assert_allclose(linear_step(x, a), x, atol=1e-3)  # it rests there, at the velocity that takes


def test_a_recorded_cost_is_fitted_as_a_square():
    observations, actions = random_episodes(linear_step, 4)
    costs = (observations[..., 0] - 0.5) ** 2 + 0.1 * observations[..., 1] ** 2 + 0.01 * actions[..., 0] ** 2
    fitted = fit_lifted_cost(observations, actions, costs, Identity(2), 0.01)
    np.testing.assert_allclose(fitted(observations, actions), costs, atol=1e-6 * costs.max())
    one_row = fit_lifted_cost(observations, actions, costs, Identity(2), 0.01, rank=1)
    assert len(one_row.offset) == 1


def test_a_cost_that_is_no_square_is_fitted_as_well_as_squares_can():
    observations, actions = random_episodes(linear_step, 5)
    costs = -np.square(observations).sum(-1)
    fitted = fit_lifted_cost(observations, actions, costs, Polynomial(2, 1, False), 0.0)
    assert np.abs(fitted(observations, actions)).max() < 1e-6 * np.abs(costs).max()


def test_what_does_not_fit_is_named():
    observations, actions = random_episodes(linear_step, 0)
    cost = TargetCost([1, 1], [0, 0], 0.1)
    with pytest.raises(LiftedModelError, match="5 of actions"):
        fit_edmdc(observations, actions[:5], Identity(2), cost, 0.1)
    with pytest.raises(LiftedModelError, match=r"give \(T, 3\)"):
        fit_edmdc(observations, actions, Identity(3), cost, 0.1)
    with pytest.raises(LiftedModelError, match="two steps"):
        fit_edmdc(observations[:, :1], actions[:, :1], Identity(2), cost, 0.1)
    with pytest.raises(LiftedModelError, match="negative eigenvalue"):
        target_cost(np.eye(2), [1, -1], [0, 0], 0.1)
    with pytest.raises(LiftedModelError, match="not symmetric"):
        target_cost(np.eye(2), [[1, 1], [0, 1]], [0, 0], 0.1)
    with pytest.raises(LiftedModelError, match="all zero"):
        target_cost(np.eye(2), [0, 0], [0, 0], 0.1)
    good = target_cost(np.eye(2), [1, 1], [0, 0], 0.1)
    with pytest.raises(LiftedModelError, match="A has shape"):
        LiftedLinearModel(Identity(3), MATRIX, INPUTS, good, 0.1)
    with pytest.raises(LiftedModelError, match="B has shape"):
        LiftedLinearModel(Identity(2), MATRIX, INPUTS.T, good, 0.1)
    with pytest.raises(LiftedModelError, match="not finite"):
        LiftedLinearModel(Identity(2), MATRIX * np.nan, INPUTS, good, 0.1)
    with pytest.raises(LiftedModelError, match="time_step"):
        LiftedLinearModel(Identity(2), MATRIX, INPUTS, good, 0.0)


def test_a_pendulum_is_balanced_upright_with_a_fitted_model():
    env = gymnasium.make("Pendulum-v1")
    rng = np.random.default_rng(0)

    def start(angle, speed):
        env.reset(seed=0)
        env.unwrapped.state = np.array([angle, speed])
        return np.array([np.sin(angle), speed])

    observations, actions = np.zeros((40, 12, 2)), rng.uniform(-2, 2, (40, 12, 1))
    for episode in range(40):
        o = start(rng.uniform(-0.4, 0.4), rng.uniform(-0.5, 0.5))
        for k in range(12):
            observations[episode, k] = o
            o = env.step(actions[episode, k])[0][1:]
    cost = TargetCost([1.0, 0.1], [0.0, 0.0], 0.001)
    model = fit_edmdc(observations, actions, Identity(2), cost, 0.05)
    planner = make_planner(model, PlannerConfig(15), np.array([-2.0]), np.array([2.0]))
    for angle in (-0.2, -0.1, 0.15, 0.2):
        o, a = start(angle, 0.0), np.zeros(1)
        planner.reset()
        for _ in range(100):
            following = a + planner.plan(*model.linearise(o, a), a)
            o, a = env.step(a)[0][1:], following
        assert np.abs(o).max() < 0.02

"""Rolls of linear systems against the matrix exponential of the continuous system with a held input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, expm

from deepkoco.koopman.forward_model import ForwardModel, step_means
from deepkoco.koopman.latent_model import DenseTransition, JordanBlocks
from deepkoco.koopman.lifting import Identity
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, target_cost
from deepkoco.koopman.matrix_powers import MatrixPowers
from deepkoco.koopman.roll import LatentRoll, ObservationRoll, roll_latent

STEP = 0.05  # [s]


def held_input_model(generator, inputs):
    """x' = G x + H a with a held, over one step of STEP seconds: A and B of z_{k+1} = A z_k + B a_k."""
    size, actions = len(generator), inputs.shape[1]
    joint = np.zeros((size + actions, size + actions))
    joint[:size, :size], joint[:size, size:] = generator, inputs
    power = expm(joint * STEP)
    cost = target_cost(np.eye(size), np.ones(size), np.zeros(size), 0.1)
    return LiftedLinearModel(Identity(size), power[:size, :size], power[:size, size:], cost, STEP), joint


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**20), changes=st.integers(0, 5), elapsed=st.floats(0.01, 12.0))
def test_the_roll_of_a_linear_system_is_its_matrix_exponential_for_any_time_and_any_changes(
    seed, changes, elapsed
):
    rng = np.random.default_rng(seed)
    model, joint = held_input_model(rng.normal(size=(3, 3)), rng.normal(size=(3, 2)))
    times = np.sort(rng.uniform(0.0, elapsed, changes))
    actions = rng.normal(size=(1 + changes, 2))
    x = start = rng.normal(size=3)
    for begin, end, action in zip([0.0, *times], [*times, elapsed], actions, strict=True):
        x = (expm(joint * STEP * (end - begin)) @ np.concatenate((x, action)))[:3]
    rows, _ = LatentRoll(model).linearise_later(start, elapsed, times, actions)
    np.testing.assert_allclose(rows[0], [*x, *actions[-1], 1.0], atol=1e-7 * max(1.0, np.abs(x).max()))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**20), pairs=st.integers(1, 4), changes=st.integers(0, 4))
def test_the_roll_of_jordan_blocks_adds_what_each_change_of_the_action_became(seed, pairs, changes):
    rng = np.random.default_rng(seed)
    mu, omega = rng.normal(size=pairs), rng.uniform(0.0, 6.0, pairs)
    generator = block_diag(*(np.array([[m, -w], [w, m]]) for m, w in zip(mu, omega, strict=True))) * STEP
    rows, increments = rng.normal(size=(3, 2 * pairs)), rng.normal(size=(changes, 2))
    elapsed = rng.uniform(0.0, 10.0)
    times = np.sort(rng.uniform(0.0, elapsed, changes))
    expected = expm(generator * elapsed) @ rows[0]
    for time, increment in zip(times, increments, strict=True):
        expected = expected + expm(generator * (elapsed - time)) @ (increment @ rows[1:])
    dynamics = JordanBlocks(np.exp((mu + 1j * omega) * STEP))
    np.testing.assert_allclose(
        roll_latent(dynamics, rows, elapsed, times, increments),
        expected,
        atol=1e-10 * (1 + np.abs(expected).max()),
    )


def test_a_roll_over_whole_steps_is_the_model_stepped():
    dynamics = DenseTransition(np.array([[1.0, 0.1], [-0.2, 0.9]]))
    rows, increments = np.array([[1.0, 2.0], [0.5, -1.0]]), np.array([[0.3], [-0.7]])
    expected = dynamics.advance(dynamics.advance(rows[0]) + 0.3 * rows[1]) - 0.7 * rows[1]
    np.testing.assert_allclose(roll_latent(dynamics, rows, 2.0, np.array([1.0, 2.0]), increments), expected)


def test_half_a_step_twice_is_one_step():
    powers = MatrixPowers(np.array([[1.0, 0.1], [0.0, 1.0]]))
    np.testing.assert_allclose(powers.power(0.5), [[1.0, 0.05], [0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(powers.power(0.5) @ powers.power(0.5), powers.power(1.0), atol=1e-15)
    assert powers.exact


@pytest.mark.parametrize("matrix", [np.diag([-0.5, 1.0]), np.eye(2, k=1)])
def test_between_whole_powers_of_a_matrix_without_real_logarithm_it_is_linear(matrix):
    powers = MatrixPowers(matrix)
    assert not powers.exact
    np.testing.assert_allclose(powers.power(3.0), matrix @ matrix @ matrix)
    np.testing.assert_allclose(powers.power(1.25), 0.75 * matrix + 0.25 * matrix @ matrix)


def test_a_power_that_is_whole_but_for_rounding_is_whole():
    matrix = np.diag([-0.5, 1.0])
    assert np.array_equal(MatrixPowers(matrix).power(0.15 / 0.05), np.linalg.matrix_power(matrix, 3))


def linear_forward_model():
    """o' = o + small change: tanh is the identity for small numbers, so a tiny first layer makes g linear."""
    scale = 1e-6
    gain = np.array([[0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])  # x += 0.1 v, v += 0.1 a
    return ForwardModel(((np.eye(3) * scale, np.zeros(3)), (gain / scale, np.zeros(2))), STEP)


def test_a_prediction_repeats_the_step_and_takes_a_part_of_the_last_one():
    forward = linear_forward_model()
    # Steps of 0.1: (0, 1) -> (0.1, 1.2) -> (0.22, 1.4), then half of the change (0.14, 0.2).
    predicted = forward.predict(np.array([0.0, 1.0]), 2.5, np.zeros(0), np.array([[2.0]]))
    np.testing.assert_allclose(predicted, [0.29, 1.5], atol=1e-9)


def test_an_action_that_changes_within_a_step_counts_by_its_share():
    # 1 until 0.25, 3 until 1.5, then -1 until the end at 2.5.
    means = step_means(3, 2.5, np.array([0.25, 1.5]), np.array([[1.0], [3.0], [-1.0]]))
    np.testing.assert_allclose(means[:, 0], [0.25 * 1 + 0.75 * 3, 0.5 * 3 - 0.5 * 1, -1.0])


def test_an_action_that_changes_between_steps_is_held_over_whole_ones():
    # 1 for two steps, 3 for one; -1 begins at the end and 5 was replaced at once.
    means = step_means(3, 3.0, np.array([2.0, 2.0, 3.0]), np.array([[1.0], [5.0], [3.0], [-1.0]]))
    assert means[:, 0].tolist() == [1.0, 1.0, 3.0]


@pytest.mark.parametrize("widths", [(), (5,), (5, 7)])
def test_a_prediction_is_the_sum_of_its_changes(widths):
    rng, sizes = np.random.default_rng(0), (5, *widths, 3)
    layers = zip(sizes[1:], sizes[:-1], strict=True)
    forward = ForwardModel(tuple((rng.normal(size=(a, b)), rng.normal(size=a)) for a, b in layers), STEP)
    x, actions = rng.normal(size=3), rng.normal(size=(2, 2))
    predicted = forward.predict(x, 2.25, np.array([1.5]), actions)
    for action, part in ((actions[0], 1.0), (actions.mean(0), 1.0), (actions[1], 0.25)):
        x = x + part * forward.change(x, action)
    np.testing.assert_allclose(predicted, x, atol=1e-12)


def test_the_observation_is_predicted_and_then_encoded_with_the_last_action(model):
    forward = ForwardModel(
        ((np.zeros((1, 4)), np.zeros(1)), (np.zeros((3, 1)), np.array([0.1, 0.2, 0.3]))), STEP
    )
    start, actions = np.zeros(3), np.array([[0.5], [-0.5]])
    rows, factor = ObservationRoll(model, forward).linearise_later(start, 2.0, np.array([1.0]), actions)
    expected, expected_factor = model.linearise(np.array([0.2, 0.4, 0.6]), np.array([-0.5]))
    np.testing.assert_allclose(rows, expected)
    np.testing.assert_allclose(factor, expected_factor)


@pytest.fixture
def model():
    rng = np.random.default_rng(0)
    cost = target_cost(np.eye(3), np.ones(3), np.zeros(3), 0.1)
    return LiftedLinearModel(Identity(3), rng.normal(size=(3, 3)), rng.normal(size=(3, 1)), cost, STEP)

"""A policy among delays: on linear systems, where the roll is exact, they only shift the loop."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.agent.delayed_policy import DelayedPolicy, DelayError
from deepkoco.agent.policy import KoopmanPolicy, ObservationError
from deepkoco.koopman.forward_model import ForwardModel, ForwardModelError
from deepkoco.koopman.lifting import Identity
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, target_cost
from deepkoco.planning import PlannerConfig

STEP = 0.1  # [s]
LIMIT = np.array([1.0])


def advance(x, action, duration=STEP):
    """A mass on which a force acts: position [m] and velocity [m/s]."""
    return np.array([x[0] + duration * x[1] + 0.5 * duration**2 * action, x[1] + duration * action])


@pytest.fixture(scope="module")
def mass():
    cost = target_cost(np.eye(2), np.array([1.0, 0.1]), np.zeros(2), 0.01)
    inputs = np.array([[0.5 * STEP**2], [STEP]])
    return LiftedLinearModel(Identity(2), np.array([[1.0, STEP], [0.0, 1.0]]), inputs, cost, STEP)


def run(policy, start, sensing, actuation, steps, act):
    """The loop with constant delays in whole steps: states x_0 .. (steps, 2) and what acted (steps,)."""
    states, sent, applied = [np.array(start)], [], []
    for k in range(steps):
        sent.append(act(policy, states[max(k - sensing, 0)], min(sensing, k)).item())
        applied.append(sent[k - actuation] if k >= actuation else 0.0)
        states.append(advance(states[-1], applied[-1]))
    return np.array(states), np.array(applied)


def undelayed(model, start, steps):
    policy = KoopmanPolicy(model, PlannerConfig(horizon=12), -LIMIT, LIMIT)
    return run(policy, start, 0, 0, steps, lambda p, o, age: p.act(o))


@settings(max_examples=12, deadline=None)
@given(
    sensing=st.integers(0, 6), actuation=st.integers(0, 6), position=st.floats(-2, 2), speed=st.floats(-1, 1)
)
def test_constant_delays_shift_the_loop_of_a_linear_system_by_the_actuation_delay(
    mass, sensing, actuation, position, speed
):
    policy = DelayedPolicy(
        mass,
        PlannerConfig(horizon=12),
        -LIMIT,
        LIMIT,
        sensing_delay=sensing * STEP,
        actuation_delay=actuation * STEP,
    )
    # The expected age of the first observations is more than the episode is old, and is cut there.
    states, applied = run(policy, (position, speed), sensing, actuation, 40, lambda p, o, age: p.act(o))
    drifted = np.array([position + actuation * STEP * speed, speed])
    expected, commands = undelayed(mass, drifted, 40 - actuation)
    np.testing.assert_allclose(states[actuation:], expected, atol=1e-5)
    np.testing.assert_allclose(applied[actuation:], commands, atol=1e-5)


def test_a_command_that_acts_a_part_of_a_step_late_shifts_the_loop_by_that_part(mass):
    late = 0.4 * STEP
    policy = DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT, actuation_delay=late)
    x, before, states = np.array([1.0, 0.2]), 0.0, []
    for _ in range(30):
        command = policy.act(x).item()
        states.append(advance(x, before, late))  # when the command begins to act
        x, before = advance(states[-1], command, STEP - late), command
    expected, _ = undelayed(mass, states[0], 30)
    np.testing.assert_allclose(states, expected[:30], atol=1e-5)


def test_random_ages_and_any_order_change_nothing_when_they_are_known(mass):
    rng = np.random.default_rng(3)
    ages = [min(int(rng.integers(0, 6)), k) for k in range(40)]
    policy = DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT)
    x, states = np.array([1.0, -0.3]), []
    for age in ages:
        states.append(x)
        # With age 0 the newest is there; else an older one comes, sometimes older than the one before.
        x = advance(x, policy.act(states[-1 - age], observation_age=age * STEP).item())
    expected, _ = undelayed(mass, states[0], 40)
    np.testing.assert_allclose(states, expected[:40], atol=1e-5)


def test_changing_actuation_delays_are_bridged_when_they_are_known(mass):
    """Every command knows its delay; the state at which it begins to act is rolled to exactly."""
    rng = np.random.default_rng(5)
    policy = DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT)
    x, arrivals, commands = np.array([1.5, 0.0]), [], []
    for k in range(80):
        delay = float(rng.uniform(0.0, 0.35))
        commands.append(policy.act(x, observation_age=0.0, actuation_delay=delay).item())
        arrivals.append(k * STEP + delay)
        changes = sorted({t for t in arrivals if k * STEP < t < (k + 1) * STEP})
        for begin, end in zip([k * STEP, *changes], [*changes, (k + 1) * STEP], strict=True):
            there = [c for c, t in zip(commands, arrivals, strict=True) if t <= begin + 1e-12]
            x = advance(x, there[-1] if there else 0.0, end - begin)
    assert np.abs(x).max() < 0.01


def test_without_delays_it_is_the_uncompensated_policy_bit_for_bit(mass):
    plain = KoopmanPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT)
    forward = ForwardModel(((np.ones((4, 3)), np.zeros(4)), (np.ones((2, 4)), np.ones(2))), STEP)
    given = [
        (DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT, roll), age, delay)
        for roll in (None, forward)
        for age, delay in ((None, None), (0.0, 0.0))
    ]
    for observation in np.random.default_rng(0).normal(size=(30, 2)):
        expected = plain.act(observation)
        for policy, age, delay in given:
            assert np.array_equal(policy.act(observation, age, delay), expected)


def test_an_episode_after_a_reset_is_the_same_again(mass):
    policy = DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT, None, 0.2, 0.3)
    first = run(policy, (1.0, 0.0), 2, 3, 15, lambda p, o, age: p.act(o))
    policy.reset()
    again = run(policy, (1.0, 0.0), 2, 3, 15, lambda p, o, age: p.act(o))
    assert np.array_equal(first[0], again[0])


@pytest.mark.parametrize("name", ["sensing_delay", "actuation_delay"])
@pytest.mark.parametrize("delay", [-0.1, float("nan"), float("inf")])
def test_delays_that_are_no_seconds_are_refused(mass, name, delay):
    with pytest.raises(DelayError, match=name):
        DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT, **{name: delay})


def test_wrong_observations_clocks_and_forward_models_are_refused(mass):
    policy = DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT)
    with pytest.raises(ObservationError, match="takes"):
        policy.act(np.zeros(3))
    policy.reset()
    policy.act(np.zeros(2), now=2.0)
    with pytest.raises(DelayError, match="before the last call"):
        policy.act(np.zeros(2), now=1.0)
    other = ForwardModel(((np.ones((4, 3)), np.zeros(4)), (np.ones((2, 4)), np.ones(2))), 0.02)
    with pytest.raises(ForwardModelError, match=r"0\.02 s"):
        DelayedPolicy(mass, PlannerConfig(horizon=12), -LIMIT, LIMIT, other)

"""Efforts of actuators with a time constant as states of the filter: by hand, exactly, and against true states."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.envs.estimator_wrapper import VectorEstimatorWrapper
from deepkoco.fit.state.estimator import DelayedEstimator, system_derivative, system_measurement
from deepkoco.fit.state.estimator_node import StateEstimator
from deepkoco.fit.state.lags import LagStates, mean_further_delay
from deepkoco.fit.state.unscented import Belief
from deepkoco.graph import Input
from deepkoco.systems import Channel, ExtendedSystem, Parameter, System, make_system

F64 = torch.float64
LAG, DAMPING, POSITION_SD, SPEED_NOISE, EFFORT_NOISE = 0.15, 0.5, 0.02, 0.2, 0.3
ACTUATION = 0.02
A = np.array([[0.0, 1.0, 0.0], [0.0, -DAMPING, 1.0], [0.0, 0.0, -1.0 / LAG]])
B = np.array([0.0, 0.0, 1.0 / LAG])
DENSITY = np.diag([0.0, SPEED_NOISE**2, EFFORT_NOISE**2])
START_SD = (1.0, 1.0, 0.5)


class SlowSled(System):
    """x'' = e - d x' of 1 kg, T e' = u - e; only the position is measured."""

    name = "slow_sled"
    joint_units = ("m",)
    parameters = (Parameter("damping", DAMPING, "N s/m", 0.0, 5.0, 0.1, "d"),)
    commands = (Channel("push", "N", "command", -5.0, 5.0),)
    measurements = (Channel("x", "m", "measurement", noise_sd=POSITION_SD),)

    def accelerations(self, parameters):
        return lambda motion: (motion.efforts[0] + motion.load(0) - parameters["damping"] * motion.speeds[0],)

    def command_lags(self, parameters):
        return torch.tensor(LAG, dtype=F64)


def exact(measurements, commands, stop, idle):
    """State and covariance (3) at ``stop`` of a Kalman filter of position, speed and effort."""
    mean, covariance, at = np.array([0.0, 0.0, idle]), np.diag(START_SD) ** 2, 0.0
    for taken, value in [*measurements, (stop, None)]:
        for left, right in pairwise([at, *(t for t, _ in commands if at < t < taken), taken]):
            push, h = [u for t, u in commands if t <= left][-1], right - left
            block = np.zeros((6, 6))  # Van Loan: transition and integral of the noise in one exponential
            block[:3, :3], block[:3, 3:], block[3:, 3:] = -A, DENSITY, A.T
            big, driven = expm(block * h), np.zeros((4, 4))
            phi, driven[:3, :3], driven[:3, 3] = big[3:, 3:].T, A, B
            mean = phi @ mean + expm(driven * h)[:3, 3] * push
            covariance = phi @ covariance @ phi.T + phi @ big[:3, 3:]
        at = taken
        if value is not None:
            gain = covariance[:, 0] / (covariance[0, 0] + POSITION_SD**2)
            mean, covariance = mean + gain * (value - mean[0]), covariance - np.outer(gain, covariance[0])
    return mean, covariance


SENT, PUSHES, IDLE = (0.0, 0.1, 0.2), (1.0, -2.0, 0.5), 0.4
TAKEN, SHOWN = (0.03, 0.07, 0.12, 0.19, 0.24), (0.1, 0.05, 0.2, 0.1, 0.15)
ACTING = [(-math.inf, IDLE), *((t + ACTUATION, u) for t, u in zip(SENT, PUSHES, strict=True))]


def window(times, values, first):
    """Messages as an input at 0.3 s, the number ``first`` being the oldest."""
    sent = torch.tensor([times], dtype=F64)
    seq = torch.arange(first, first + len(times))[None]
    return Input(
        torch.tensor(values, dtype=F64)[None, :, None], seq, sent, sent, torch.tensor([0.3], dtype=F64)
    )


def test_an_effort_and_its_mean_over_a_step_are_those_worked_out_by_hand():
    """From 1 to 3 in one time constant: 3 - 2/e at the end, and 3 - 2 (1 - 1/e) in the mean."""
    lags = LagStates(SlowSled())
    points = torch.tensor([[[0.0, 0.0, 1.0]]], dtype=F64)
    mean, (end,) = lags.after(points, torch.tensor([[3.0]], dtype=F64), torch.tensor([[LAG]], dtype=F64), {})
    assert float(end) == pytest.approx(3.0 - 2.0 / math.e)
    assert float(mean) == pytest.approx(3.0 - 2.0 * (1.0 - 1.0 / math.e))


def test_a_step_of_no_length_changes_nothing():
    lags = LagStates(SlowSled())
    points = torch.tensor([[[0.0, 0.0, 1.0]]], dtype=F64)
    mean, (end,) = lags.after(points, torch.tensor([[3.0]], dtype=F64), torch.zeros(1, 1, dtype=F64), {})
    assert (float(mean), float(end)) == (1.0, 1.0)


def test_only_actuators_with_a_time_constant_have_a_state():
    assert LagStates(make_system("rod_pendulum")).commands == ()
    assert LagStates(make_system("quadrotor")).commands == (0, 1, 2)
    assert LagStates(make_system("quadrotor")).width == 9


@pytest.mark.parametrize("ahead", [ACTUATION, 0.1])
def test_the_node_matches_an_exact_kalman_filter_with_the_effort_as_a_state(ahead):
    estimator = StateEstimator(
        SlowSled(), 10.0, tuple(np.diag(DENSITY)), (POSITION_SD,), ahead=ahead, actuation_delay=ACTUATION,
        measurement_period=0.02, latest=0.1, start_sd=START_SD, idle=(IDLE,), longest_step=0.0005,
    )  # fmt: skip
    state = estimator.init({}, torch.Generator(), 1)
    inputs = {"sensor": window(TAKEN, SHOWN, 0), "agent": window((-math.inf, *SENT), (IDLE, *PUSHES), -1)}
    _, output = estimator.step({}, state, inputs)
    mean, covariance = exact(list(zip(TAKEN, SHOWN, strict=True)), ACTING, 0.3 + ahead, IDLE)
    own = torch.cat([output["state"], output["effort"]], 1)[0].numpy()
    assert own == pytest.approx(mean, rel=2e-3, abs=2e-3)
    # Half of the noise enters before a step and half behind: to first order, and a sixth of a second is a long step.
    spread = output["root"][0].norm(dim=-1).numpy()
    assert spread == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.15)


def test_the_estimator_of_logs_matches_it_too():
    system = SlowSled()
    estimator = DelayedEstimator(
        system_derivative(system, system.default_parameters()), system_measurement(system),
        torch.from_numpy(DENSITY), torch.tensor([POSITION_SD], dtype=F64), longest_step=0.001,
    )  # fmt: skip
    start = Belief(
        torch.tensor([[0.0, 0.0, IDLE]], dtype=F64), torch.diag(torch.tensor(START_SD, dtype=F64))[None]
    )
    memory = estimator.start(start, torch.zeros(1, dtype=F64), torch.tensor([[IDLE]], dtype=F64))
    for time, push in zip(SENT, PUSHES, strict=True):
        memory = estimator.send(
            memory, torch.tensor([time], dtype=F64), torch.tensor([[push]], dtype=F64), ACTUATION
        )
    for time, value in zip(TAKEN, SHOWN, strict=True):
        memory = estimator.receive(
            memory, torch.tensor([time], dtype=F64), torch.tensor([[value]], dtype=F64), 0.0
        )
    found = estimator.estimate(memory, torch.tensor([0.3], dtype=F64), ACTUATION)
    mean, covariance = exact(list(zip(TAKEN, SHOWN, strict=True)), ACTING, 0.3 + ACTUATION, IDLE)
    assert found.mean[0].numpy() == pytest.approx(mean, rel=2e-3, abs=2e-3)
    assert found.covariance[0].numpy() == pytest.approx(covariance, rel=0.05, abs=2e-3)


LATE = 0.04


def flown(envs, steps=40):
    """Observations along random commands about the hover, and the true states then."""
    rng, seen, truth = np.random.default_rng(1), [], []
    observation, _ = envs.reset(seed=5)
    for _ in range(steps):
        seen.append(observation)
        truth.append(envs.unwrapped.state.nodes["agent"]["truth"].numpy().copy())
        action = np.clip(rng.normal(0.0, 0.3, (envs.num_envs, 3)), -1.0, 1.0)
        observation, *_ = envs.step(action.astype(np.float32))
    return np.array(seen), np.array(truth)


def quadrotors(count=4, **settings):
    return DelayGraphVectorEnv(
        count,
        60,
        system="quadrotor",
        task="quadrotor_circle",
        sensing_delay=LATE,
        executor="eager",
        **settings,
    )


def shown_states(envs, seen):
    """States (T, B, 8) that observations show."""
    return np.array(
        [[envs.unwrapped.task.measurement(envs.unwrapped.system, o) for o in row] for row in seen]
    )


def test_the_prediction_of_a_quadrotor_shows_the_state_that_its_commands_meet():
    """Its commands act 15, 34 and 34 ms late, in the mean 28 ms: between the next step and the one after it."""
    assert mean_further_delay(make_system("quadrotor")) + 0.015 == pytest.approx(0.0277, abs=1e-4)
    envs = quadrotors(estimator="predicted")
    seen, truth = flown(envs)
    predicted = shown_states(envs, seen)[10:-2, :, 3:6]
    share = 0.02767 / 0.02 - 1.0
    met = (1.0 - share) * truth[11:-1, :, 3:6] + share * truth[12:, :, 3:6]
    plain = quadrotors()
    seen, truth = flown(plain)
    newest = shown_states(plain, seen)[10:-2, :, 3:6]
    behind = newest - ((1.0 - share) * truth[11:-1, :, 3:6] + share * truth[12:, :, 3:6])
    # Of the speeds, which the lagging thrust and attitude change; without them the filter would be far off.
    assert np.sqrt(((predicted - met) ** 2).mean()) < 0.2 * np.sqrt((behind**2).mean())


def test_the_efforts_that_the_filter_carries_are_those_of_the_world():
    envs = quadrotors(estimator="filtered")
    flown(envs)
    own, world = envs.state.nodes["estimator"], envs.state.nodes["world"]
    # The belief is of the newest measurement, 40 ms ago; in this time an attitude makes a quarter of its way at most.
    carried, now = own["mean"][:, -2:].numpy(), world["effort"][:, 1:].numpy()
    assert np.corrcoef(carried.ravel(), now.ravel())[0, 1] > 0.8


def test_the_compiled_filter_does_what_the_eager_one_does():
    """Of one joint: the kernel of a quadrotor's filter takes a minute to compile."""
    lagging = ExtendedSystem(make_system("torque_pendulum"), ("lag",), {"lag.time_constant": 0.1})
    observations = {}
    for executor in ("eager", "fused"):
        envs = DelayGraphVectorEnv(
            2, 40, system="torque_pendulum", model=lagging, noise=True, sensing_delay=LATE, executor=executor,
            estimator="predicted",
        )  # fmt: skip
        rng, rows = np.random.default_rng(0), [envs.reset(seed=1)[0]]
        rows += [envs.step(rng.uniform(-1.0, 1.0, (2, 1)).astype(np.float32))[0] for _ in range(20)]
        assert envs.executor == executor
        observations[executor] = np.array(rows)
    np.testing.assert_allclose(observations["fused"], observations["eager"], atol=1e-5)


def test_the_wrapper_shows_what_the_node_shows_of_a_quadrotor():
    """Two implementations: exact steps of the efforts in one, Runge-Kutta and commands of any age in the other."""
    wrapped = VectorEstimatorWrapper(quadrotors(2), sensing_delay=LATE)
    seen, _ = flown(wrapped, 15)
    expected, _ = flown(quadrotors(2, estimator="predicted"), 15)
    np.testing.assert_allclose(seen[5:, :, :6], expected[5:, :, :6], atol=0.02)

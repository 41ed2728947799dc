"""The quadrotor in space: against rotation matrices, an independent integration, and its own inverse."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.systems import Motion, make_system
from deepkoco.systems.bodies.quadrotor import attitude_for, hover_thrust

SYSTEM = make_system("quadrotor")
NOMINAL = {name: float(value) for name, value in SYSTEM.default_parameters().items()}


def motion(speeds, efforts):
    numbers = [
        tuple(torch.tensor(x, dtype=torch.float64) for x in part) for part in ((0.0,) * 3, speeds, efforts)
    ]
    return Motion(*numbers)


def slope(state, efforts, p):
    """Time derivative of position and velocity, with the thrust turned by rotation matrices."""
    thrust, roll, pitch = efforts
    attitude = Rotation.from_euler("xy", [p["roll_gain"] * roll, p["pitch_gain"] * pitch])
    drag = np.array([p["drag"], p["drag"], p["drag_up"]]) * state[3:]
    push = attitude.apply([0.0, 0.0, thrust]) - drag
    return np.concatenate([state[3:], push / p["mass"] - np.array([0.0, 0.0, 9.81])])


def test_accelerations_are_those_of_a_turned_thrust():
    p = SYSTEM.default_parameters() | {"roll_gain": torch.tensor(0.9), "pitch_gain": torch.tensor(1.1)}
    found = SYSTEM.accelerations(p)(motion((0.4, -0.3, 0.2), (0.35, 0.2, -0.3)))
    expected = slope(
        np.array([0, 0, 0, 0.4, -0.3, 0.2]), (0.35, 0.2, -0.3), {n: float(v) for n, v in p.items()}
    )
    assert [float(x) for x in found] == pytest.approx(expected[3:])


def test_it_hovers_at_its_weight():
    found = SYSTEM.accelerations(SYSTEM.default_parameters())(
        motion((0.0,) * 3, (hover_thrust(SYSTEM.default_parameters()), 0.0, 0.0))
    )
    assert [float(x) for x in found] == pytest.approx([0.0] * 3, abs=1e-12)


@pytest.mark.parametrize("wanted", [(1.0, -2.0, 0.5), (-3.0, 0.0, -2.0)])
def test_thrust_and_attitude_for_an_acceleration_give_it(wanted):
    found = SYSTEM.accelerations(SYSTEM.default_parameters())(
        motion((0.0,) * 3, attitude_for(wanted, NOMINAL["mass"]))
    )
    assert [float(x) for x in found] == pytest.approx(wanted)


def integrated(commands, p, seconds, sent_late):
    """Position and velocity with each command behind its own delay and lag, by an adaptive integration."""
    lags = (p["motor_lag"], p["roll_lag"], p["pitch_lag"])
    delays = [p[f"{name}_delay"] + sent_late for name in ("thrust", "roll", "pitch")]

    def law(t, y):
        held = []
        for i, delay in enumerate(delays):
            k = math.floor((t - delay) / 0.02 + 1e-9)
            held.append(commands[min(k, len(commands) - 1)][i] if k >= 0 else 0.0)
        answers = [(u - a) / lag for u, a, lag in zip(held, y[6:], lags, strict=True)]
        return np.concatenate([slope(y[:6], y[6:], p), answers])

    return solve_ivp(law, (0.0, seconds), np.zeros(9), max_step=5e-4, rtol=1e-7, atol=1e-9).y[:6, -1]


@pytest.mark.parametrize("executor", ["eager", "fused"])
def test_in_an_environment_each_command_has_its_own_delay_and_lag(executor):
    p = NOMINAL | {"thrust_delay": 0.012, "roll_delay": 0.045, "pitch_delay": 0.021}
    ranges = {name: (p[name], p[name]) for name in ("thrust_delay", "roll_delay", "pitch_delay")}
    envs = DelayGraphVectorEnv(
        2,
        40,
        system="quadrotor",
        action_units="physical",
        executor=executor,
        world_rate=200.0,
        randomize=ranges,
    )
    envs.reset(seed=0, options={"initial_state": np.zeros((2, 6))})
    rng = np.random.default_rng(0)
    commands = np.array([0.33, 0.0, 0.0]) + rng.uniform(-1.0, 1.0, (15, 3)) * np.array([0.1, 0.3, 0.3])
    for command in commands:
        envs.step(np.stack([command, command]).astype(np.float32))
    assert envs.executor == executor
    found = envs.state.nodes["agent"]["truth"][1].numpy()
    np.testing.assert_allclose(found, integrated(commands, p, 0.3, 0.0), atol=3e-3)


def test_its_picture_moves_with_it():
    left, right = (SYSTEM.draw(np.array([x, 0.0, 0.0, 0, 0, 0]), np.zeros(3), 64) for x in (-0.8, 0.8))
    assert np.argwhere((left != right).any(-1)).size

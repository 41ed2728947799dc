"""Environments of joints that stick, and of effects that remember the way of a joint."""

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco")

import deepkoco
from deepkoco.engines.ode import World
from deepkoco.envs.tasks import GoalTask
from deepkoco.graph import Input
from deepkoco.systems import ExtendedSystem, make_system
from tests.oracle.stick_slip import stick_slip_log, stick_slip_system

LEVELS = {"hinge": (0.6,), "slide": (1.5,), "arm": (1.0, 0.5)}
STILL = {"hinge": 1e-3, "slide": 1e-4, "arm": 1e-3}  # speed below which MuJoCo's joint sticks


def rubbing(kind):
    base = stick_slip_system(kind)
    names = [base.at_joint("coulomb", j) for j in range(base.joints)]
    return ExtendedSystem(
        base, tuple(names), {f"{n}.torque": v for n, v in zip(names, LEVELS[kind], strict=True)}
    )


def truth(envs):
    return envs.state.nodes["world"]["state"].numpy().copy()


@pytest.mark.parametrize("executor", ["eager", "fused"])
@pytest.mark.parametrize("kind", list(LEVELS))
def test_environment_sticks_and_slides_as_mujoco(kind, executor):
    windows, steps = 9, 50  # of 1 s, one in each environment
    log = stick_slip_log(
        kind, LEVELS[kind], 1, windows + 1.0, noisy=False, reach=3.0 if kind == "hinge" else 2.0
    )
    system = rubbing(kind)
    shown = np.stack([log.channels[c.name].value for c in system.measurements], -1)[::2]  # at 50 Hz
    sent = np.stack([log.channels[c.name].value for c in system.commands], -1)
    joints = system.joints
    envs = deepkoco.make_env(
        system, GoalTask(), num_envs=windows, executor=executor, action_units="physical", world_rate=200.0
    )
    start = shown[: windows * steps : steps]
    envs.reset(seed=0, options={"initial_state": start})
    assert envs.executor == executor
    found = []
    for k in range(steps):
        envs.step(sent[k : windows * steps : steps].astype(np.float32))
        found.append(truth(envs))
    found = np.stack(found, 1)
    at = np.arange(windows)[:, None] * steps + 1 + np.arange(steps)
    true = shown[at]
    for j in range(joints):
        sticks = np.abs(true[..., joints + j]) < STILL[kind]
        assert 0.05 < sticks.mean() < 0.95
        error = found[..., j] - true[..., j]
        limit = 0.3 * system.measurements[j].noise_sd
        assert np.sqrt((error[sticks] ** 2).mean()) < limit
        assert np.sqrt((error[~sticks] ** 2).mean()) < limit


def driven_by(slope, start, torques, fine=80):
    """States of a differential equation at 20 ms / fine, each torque held for 20 ms: small Runge-Kutta steps."""
    states, h = [np.array(start)], 0.02 / fine
    for u in torques:
        for _ in range(fine):
            y = states[-1]
            k1 = np.array(slope(y, u))
            k2 = np.array(slope(y + 0.5 * h * k1, u))
            k3 = np.array(slope(y + 0.5 * h * k2, u))
            states.append(y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + np.array(slope(y + h * k3, u))))
    return np.array(states)


PENDULUM = {q.name: q.value for q in make_system("torque_pendulum").parameters}


def pendulum_slope(y, u, load=0.0):
    p = PENDULUM
    q, v = y[:2]
    return v, (u + load - p["gravity_torque"] * np.sin(q) - p["viscous"] * v) / p["inertia"]


def torques():
    t = np.arange(75) * 0.02
    return 0.9 * np.sin(2.0 * t) + 0.5 * np.sin(9.0 * t)


def run(system, start, executor):
    envs = deepkoco.make_env(
        system, GoalTask(), num_envs=2, executor=executor, action_units="physical", world_rate=200.0
    )
    observation, _ = envs.reset(seed=0, options={"initial_state": [start] * 2})
    seen, states = [observation[0]], [truth(envs)[0]]
    for u in torques():
        observation, *_ = envs.step(np.full((2, 1), u, np.float32))
        seen.append(observation[0])
        states.append(truth(envs)[0])
    return np.array(seen), np.array(states)


@pytest.mark.parametrize("executor", ["eager", "fused"])
def test_bristles_bend_and_slip_in_an_environment(executor):
    level, distance, relaxation = 0.5, 0.02, 0.01
    names = ("level", "distance", "relaxation")
    values = {f"bristle.{n}": v for n, v in zip(names, (level, distance, relaxation), strict=True)}
    _, found = run(ExtendedSystem(make_system("torque_pendulum"), ("bristle",), values), (0.1, 0.8), executor)

    def slope(y, u):
        rate = (y[1] - y[2] * abs(y[1])) / distance
        return *pendulum_slope(y, u, -level * (y[2] + np.clip(relaxation * rate, -1.0, 1.0))), rate

    expected = driven_by(slope, (0.1, 0.8, 1.0), torques())[::80]  # moving, so the bristles are bent fully
    assert np.ptp(np.sign(expected[:, 1])) == 2.0  # it turns
    assert found[:, 0] == pytest.approx(expected[:, 0], abs=5e-4)
    assert found[:, 1] == pytest.approx(expected[:, 1], abs=2e-2)


@pytest.mark.parametrize("executor", ["eager", "fused"])
def test_agent_sees_the_output_of_a_gear_with_play(executor):
    width = 0.03
    system = ExtendedSystem(make_system("torque_pendulum"), ("gear_play",), {"gear_play.width": width})
    seen, states = run(system, (0.1, 0.8), executor)
    fine = driven_by(pendulum_slope, (0.1, 0.8), torques())
    output, at = [], 0.1 - width  # it moved upwards before
    for q in fine[:, 0]:
        at = min(max(at, q - width), q + width)
        output.append(at)
    expected = np.array(output)[::80]
    assert states[:, 0] == pytest.approx(fine[::80, 0], abs=1e-4)  # the play lies behind the joint
    assert np.arctan2(seen[:, 1], seen[:, 0]) == pytest.approx(expected, abs=1e-3)
    assert (seen[:, 2] == 0.0).any()
    assert (seen[:, 2] != 0.0).any()


def test_gradients_pass_through_a_world_whose_friction_is_smoothed():
    system = rubbing("hinge")
    world = World(system, 50.0)
    name = "coulomb.torque"
    level = torch.tensor(0.6, dtype=torch.float64, requires_grad=True)

    def last(value):
        parameters = {**system.default_parameters(), name: value}
        state = world.init(parameters, torch.Generator(), 1)
        state["state"] = torch.tensor([[0.2, 0.5]], dtype=torch.float64)
        for k in range(6):
            at = torch.tensor([k / 50.0], dtype=torch.float64)
            command = Input(
                torch.full((1, 1, 1), 1.5, dtype=torch.float64), torch.zeros(1, 1, dtype=torch.int64),
                torch.zeros(1, 1, dtype=torch.float64), torch.zeros(1, 1, dtype=torch.float64), at,
            )  # fmt: skip
            state, out = world.step(parameters, state, {"agent": command})
        return out[0]

    assert torch.autograd.gradcheck(last, (level,))
    last(level)[0].backward()
    assert level.grad is not None
    assert level.grad != 0.0

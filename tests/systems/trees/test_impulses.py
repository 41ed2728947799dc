"""Trees in the steps of engines of rigid bodies, against a recursion with MuJoCo's inertia and bounded impulses."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.fit.simulate.equations import equations_of
from deepkoco.fit.simulate.torch_steps import StepsInput, in_torch
from deepkoco.systems import ExtendedSystem, load_system
from deepkoco.systems.dry_friction import slide_or_stop
from deepkoco.systems.rollout import RolloutInput
from deepkoco.systems.stick_slip import Joints, StickSlip

H = 1.0 / 240.0
FRICTION, DAMPING = np.array([0.1, 0.06]), np.array([0.18, 0.08])
ARM = f"""
<mujoco model="arm"><compiler angle="radian"/>
<worldbody><body><joint name="a" axis="0 1 0" damping="{DAMPING[0]}" frictionloss="{FRICTION[0]}"/>
  <inertial pos="0.13 0 0" mass="0.9" diaginertia="0.0011 0.006 0.006"/>
  <body pos="0.28 0 0"><joint name="b" axis="0 1 0" damping="{DAMPING[1]}" frictionloss="{FRICTION[1]}"/>
    <inertial pos="0.1 0 0" mass="0.6" diaginertia="0.0005 0.0024 0.0024"/></body></body></worldbody>
<actuator><motor name="m_a" joint="a"/><motor name="m_b" joint="b"/></actuator></mujoco>
"""
START = np.array([0.9, 0.4])


def efforts(steps):
    """Loads about those that hold the arm up: the joints move, turn, and stand still at times."""
    t = H * np.arange(steps)
    return np.stack([2.2 * np.sin(2.0 * t) - 1.2, 0.8 * np.sin(3.3 * t) - 0.1], 1)


def by_impulses(sent):
    """v* = v + h M^-1 (u - D v - c), then impulses of at most h F that stop what they can, q' = q + h v'.

    Recursion that pybullet follows to 1e-15 in every step (release 3.2.7, TORQUE_CONTROL, friction as
    VELOCITY_CONTROL with the target 0 and the force F, no damping of links).
    """
    model = mujoco.MjModel.from_xml_string(ARM)
    data, mass = mujoco.MjData(model), np.zeros((2, 2))
    q, v, path, stood = START.copy(), np.zeros(2), [], 0
    for u in sent:
        path.append([*q, *v])
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        inverse = np.linalg.inv(mass)
        v = v + H * inverse @ (u - DAMPING * v - data.qfrc_bias)
        impulse = np.zeros(2)
        for _ in range(500):
            for j in range(2):
                wanted = np.clip(impulse[j] - v[j] / inverse[j, j], -H * FRICTION[j], H * FRICTION[j])
                v = v + inverse[:, j] * (wanted - impulse[j])
                impulse[j] = wanted
        stood += int((np.abs(v) < 1e-12).any())
        q = q + H * v
    return np.array(path), stood


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "arm.xml"
    path.write_text(ARM)
    return load_system(path).with_engine("semi-implicit", H)


def started(sent):
    start = [torch.tensor([[x]], dtype=torch.float64) for x in (*START, 0.0, 0.0)]
    begin = [torch.from_numpy(sent[:, k].copy()).view(-1, 1, 1) for k in range(2)]
    return start, torch.zeros(1, 1, dtype=torch.float64), begin, [torch.zeros_like(x) for x in begin]


def in_loop(system, sent):
    start, time, begin, slope = started(sent)
    p = system.default_parameters()
    given = RolloutInput(H, start, time, begin, slope, None, system.dry_friction_levels(p))
    found = system.rollout(p).run(given)
    return np.stack([x[:-1, 0, 0].numpy() for x in found.value], 1)


def step_by_step(system, sent):
    found = in_torch(
        equations_of(system, system.default_parameters(), None), StepsInput(H, *started(sent)[:4], None)
    )
    return np.stack([x[:-1, 0, 0].numpy() for x in found.value], 1)


def test_friction_takes_what_is_left_of_a_speed_or_stops_the_joint():
    # 0.5 + 0.1 * 2 = 0.7 less 0.1 * 3 is 0.4; 0.5 - 0.1 * 4 = 0.1 is less than 0.3; -0.3 from rest stays.
    speed = torch.tensor([0.5, 0.5, 0.0, -0.5], dtype=torch.float64)
    free = torch.tensor([2.0, -4.0, -3.0, 0.0], dtype=torch.float64)
    after, way = slide_or_stop(speed, free, torch.tensor(3.0, dtype=torch.float64), 0.1)
    np.testing.assert_allclose(after, [0.4, 0.0, 0.0, -0.2], atol=1e-15)
    np.testing.assert_allclose(way, [0.04, 0.0, 0.0, -0.02], atol=1e-15)


def test_a_tree_moves_by_the_impulses_of_engines(arm):
    sent = efforts(600)
    truth, stood = by_impulses(sent)
    assert stood > 10  # a joint is stopped within steps
    error = np.abs(in_loop(arm, sent) - truth).max(0)
    assert (error < 1e-6 * np.abs(truth).max(0)).all()
    machine = np.abs(in_loop(arm.with_engine(None), sent) - truth).max(0)
    assert (machine > 1e3 * error).all()


def test_steps_in_torch_have_the_same_impulses(arm):
    sent = efforts(150)
    np.testing.assert_allclose(step_by_step(arm, sent), by_impulses(sent)[0], atol=1e-9)


def test_effects_that_follow_the_speed_have_that_of_the_start_of_a_step(arm):
    sent = efforts(120)
    named = {
        "stribeck(a).coulomb": 0.03,
        "stribeck(a).breakaway": 0.05,
        "viscous(b).change": 0.05,
        "coulomb(b).torque": 0.02,
    }
    extended = ExtendedSystem(arm, ("stribeck(a)", "viscous(b)", "coulomb(b)"), named)
    ours = in_loop(extended, sent)
    np.testing.assert_allclose(step_by_step(extended, sent), ours, atol=1e-6)
    assert np.abs(ours - in_loop(arm, sent)).max() > 1e-3


def test_an_environment_takes_whole_steps_of_an_engine_in_each_tick(arm):
    sent = np.repeat(efforts(240)[::4], 4, axis=0)
    law = StickSlip(arm, arm.default_parameters())
    one = [torch.tensor([x], dtype=torch.float64) for x in START]
    zero = torch.zeros(1, dtype=torch.float64)
    joints, path = Joints(tuple(one), (zero, zero), (zero, zero), ()), []
    for u in sent[::4]:
        path.append([*map(float, joints.angles), *map(float, joints.speeds)])
        joints = law.tick(joints, tuple(torch.from_numpy(u[:, None])), 4.0 * H)
    np.testing.assert_allclose(path, by_impulses(sent)[0][::4], atol=1e-9)

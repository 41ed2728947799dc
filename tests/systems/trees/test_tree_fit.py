"""Fits of compiled trees to logs that MuJoCo itself simulated."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.fit import cut_windows, fit
from deepkoco.fit.simulate.simulator import trajectories
from deepkoco.systems.trees import TreeSystem
from tests.systems.trees.random_trees import mujoco_log

ARM = """
<mujoco model="arm">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="{shoulder}"/>
      <inertial pos="0 0 -0.15" mass="{upper}" diaginertia="0.01 0.01 0.001"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" damping="0.05" armature="0.002"/>
        <inertial pos="0 0 -0.12" mass="{fore}" diaginertia="0.004 0.004 0.0005"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m_shoulder" joint="shoulder" ctrlrange="-6 6"/>
    <motor name="m_elbow" joint="elbow" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""
GIVEN = {"shoulder": 0.1, "upper": 1.0, "fore": 0.6}
TRUE = {"shoulder": 0.16, "upper": 1.0, "fore": 0.75}


def test_fit_finds_mass_and_damping_of_an_arm_simulated_by_mujoco(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(**GIVEN))
    system = TreeSystem.from_file(path)
    rng = np.random.default_rng(0)
    held = np.repeat(rng.uniform(-1.0, 1.0, (40, 2)), 20, axis=0) * [3.0, 1.0]
    model = mujoco.MjModel.from_xml_string(ARM.format(**TRUE))
    log = mujoco_log(model, system, held, 100.0, rng)
    found = fit([log], system, ["mass(fore)", "damping(shoulder)"])
    mass, damping = (found.estimates[name] for name in ("mass(fore)", "damping(shoulder)"))
    assert abs(mass.value - TRUE["fore"]) < 0.005 * TRUE["fore"]
    assert abs(damping.value - TRUE["shoulder"]) < 0.02 * TRUE["shoulder"]


SERVO_ARM = """
<mujoco model="servo_arm">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.5" armature="0.01"/>
      <inertial pos="0 0 -0.15" mass="1" diaginertia="0.01 0.01 0.001"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" damping="0.3" armature="0.005"/>
        <inertial pos="0 0 -0.12" mass="{fore}" diaginertia="0.004 0.004 0.0005"/>
        <body name="hand" pos="0 0 -0.2">
          <joint name="wrist" axis="0 0 1" damping="1.0"/>
          <inertial pos="0 0 -0.01" mass="0.02" diaginertia="1e-5 1e-5 1e-5"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="{kp}" kv="3"/>
    <position name="elbow" joint="elbow" kp="120" kv="2"/>
    <position name="wrist" joint="wrist" kp="20"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def servo_arm(tmp_path):
    path = tmp_path / "servo_arm.xml"
    path.write_text(SERVO_ARM.format(fore=0.6, kp=300))
    return TreeSystem.from_file(path)


def servo_log(system, seconds=8.0):
    """50 Hz, with goals that jump: the servos answer within 20 ms."""
    rng = np.random.default_rng(1)
    steps = round(seconds * 50)
    goals = np.repeat(rng.uniform(-0.6, 0.6, (steps // 20 + 1, 3)), 20, axis=0)[:steps]
    model = mujoco.MjModel.from_xml_string(SERVO_ARM.format(fore=0.75, kp=220))
    return mujoco_log(model, system, goals, 50.0, rng)


def test_steps_of_a_fit_follow_stiff_servos_but_not_what_fades_within_a_fraction_of_a_millisecond(servo_arm):
    # The wrist alone would fade with 1 N m s/rad / 1e-5 kg m2 = 1e5 1/s; its servo adds nothing.
    assert 5e-4 < servo_arm.longest_step < 2e-3
    windows = cut_windows([servo_log(servo_arm, 3.0)], servo_arm, 1.0)
    assert windows.step <= servo_arm.longest_step
    inner = tuple(joint for joint in servo_arm.tree.joints if joint.name != "wrist")
    actuators = tuple(own for own in servo_arm.tree.actuators if own.name != "wrist")
    bodies = tuple(own for own in servo_arm.tree.bodies if own.name != "hand")
    sites = tuple(own for own in servo_arm.tree.sites if own.name != "hand")
    without_wrist = TreeSystem(
        replace(servo_arm.tree, joints=inner, actuators=actuators, bodies=bodies, sites=sites)
    )
    swing = math.sqrt(300.0 / 0.03)  # of the shoulder while the elbow is free [rad/s]
    assert 0.2 / swing < without_wrist.longest_step < 1.0 / swing


@pytest.mark.filterwarnings("error")
def test_fit_finds_the_gain_of_a_stiff_servo_and_a_mass_behind_it(servo_arm):
    found = fit([servo_log(servo_arm, 4.0)], servo_arm, ["mass(fore)", "kp(shoulder)"])
    assert abs(found.estimates["mass(fore)"].value - 0.75) < 0.02 * 0.75
    assert abs(found.estimates["kp(shoulder)"].value - 220.0) < 0.02 * 220.0


@pytest.mark.filterwarnings("error")
def test_a_candidate_whose_simulation_diverges_neither_warns_nor_touches_the_others(servo_arm, capfd):
    windows = cut_windows([servo_log(servo_arm, 3.0)], servo_arm, 1.0)
    values = servo_arm.default_parameters()
    states = windows.state.repeat(3, 1, 1)
    states[1, :, 4] = 1e9  # of the elbow [rad/s]
    many, _, _ = trajectories(servo_arm, windows, values, states)
    alone, _, _ = trajectories(servo_arm, windows, values, windows.state[None])
    assert not torch.isfinite(many[:, 1]).all()
    torch.testing.assert_close(many[:, [0]], alone, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(many[:, 2], many[:, 0], rtol=1e-9, atol=1e-9)
    assert capfd.readouterr().err == ""

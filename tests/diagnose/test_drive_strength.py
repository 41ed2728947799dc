"""A drive whose whole force differs by one factor: exact against MuJoCo, named, and told from another goal or load."""

import numpy as np
import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.systems import ExtendedSystem, Motion, load_system, make_system
from deepkoco.systems.effects import effects_of
from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.studies.diagnosis.hidden_cause.cases import draw_case
from tests.oracle.servo_unit import go1_like as healthy_unit
from tests.oracle.servo_unit import log_of

mujoco = mujoco_library()

XML = """<mujoco model="link"><worldbody><body name="link">
  <joint name="hinge" type="hinge" axis="0 1 0" damping="0.05" armature="0.01"/>
  <inertial pos="0.15 0 0" mass="0.8" diaginertia="0.001 0.006 0.006"/></body></worldbody>
  <actuator>{drive}</actuator></mujoco>"""
SERVO = '<general name="servo" joint="hinge" gainprm="20" biastype="affine" biasprm="0.3 -20 -0.8" gear="2"/>'
MOTOR = '<motor name="motor" joint="hinge" ctrlrange="-2 2"/>'
MODES = ("sin_sin", "up_and_down")


def robot_of(tmp_path, drive):
    file = tmp_path / "link.xml"
    file.write_text(XML.format(drive=drive))
    return load_system(file)


@pytest.mark.parametrize("factor", [0.5, 1.3])
def test_all_terms_of_a_servo_are_multiplied_as_in_mujoco(tmp_path, factor):
    system = ExtendedSystem(robot_of(tmp_path, SERVO), ("drive_strength",), {"drive_strength.factor": factor})
    model = mujoco.MjModel.from_xml_string(XML.format(drive=SERVO))
    model.actuator_gainprm *= factor
    model.actuator_biasprm *= factor
    data = mujoco.MjData(model)
    for q, v, u in np.random.default_rng(4).uniform(-2.0, 2.0, (20, 3)):
        data.qpos[0], data.qvel[0], data.ctrl[0] = q, v, u
        mujoco.mj_forward(model, data)
        motion = Motion(*((torch.tensor(x, dtype=torch.float64),) for x in (q, v, u)))
        (ours,) = system.accelerations(system.default_parameters())(motion)
        assert float(ours) == pytest.approx(float(data.qacc[0]), rel=1e-9)


def test_a_motor_has_a_gain_alone(tmp_path):
    assert "drive_strength" not in effects_of(robot_of(tmp_path, MOTOR))
    assert "drive_strength" not in effects_of(make_system("rod_pendulum"))
    assert "drive_strength" in effects_of(robot_of(tmp_path, SERVO))


def logs(factor):
    """Two healthy logs of a servo, and one with a factor on its stiffness and its damping."""
    unit = healthy_unit(0.2)
    weak = type(unit)(
        **{**vars(unit), "stiffness": factor * unit.stiffness, "damping": factor * unit.damping}
    )
    return [log_of(unit, m, 30 + k) for k, m in enumerate(MODES)], log_of(weak, "sin_sin", 40)


@pytest.mark.study
@pytest.mark.parametrize("factor", [0.7, pytest.param(1.0, marks=pytest.mark.long)])
def test_a_weak_drive_is_named_beside_healthy_logs_and_a_healthy_one_is_not(factor):
    healthy, log = logs(factor)
    result = diagnose([log], make_system("servo_pendulum"), healthy=healthy)
    if factor == 1.0:
        assert result.verdict == "nothing"
        return
    assert "drive_strength" in result.causes[0].members
    assert result.causes[0].parameters["drive_strength.factor"].value == pytest.approx(factor, rel=0.1)


@pytest.mark.study
@pytest.mark.long
def test_a_servo_that_delivers_a_ninth_less_is_no_other_load_and_no_other_goal(tmp_path):
    # A lag, a bias and the factor together. Its goal is scaled by no gain, and no single parameter does it.
    handed = draw_case(36000, 28, 16.0).question(tmp_path).handed
    result = diagnose(list(handed.log), handed.system)
    assert result.names[0] == "drive_strength"
    assert result.causes[0].parameters["drive_strength.factor"].value == pytest.approx(0.8885, rel=0.05)

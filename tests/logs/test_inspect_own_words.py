"""Columns that say their joint by a number, by one word of its name or by their values, and need no sidecar."""

import numpy as np
import pandas as pd
import pytest

import deepkoco
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import propose, survey_log
from deepkoco.logs.inspect.joints.match import match_joints
from deepkoco.logs.read_logs import read_logs
from deepkoco.logs.recording import LogError

T = np.arange(0.0, 8.0, 0.01)
FIRST, SECOND = 0.4 * np.sin(2.0 * T) + 0.3 * np.sin(3.7 * T), 0.5 * np.cos(0.9 * T) + 0.2 * np.sin(1.3 * T)


def robot(tmp_path, joints, actuators, columns):
    """Log and file of a chain of two bodies."""
    first, second = joints
    (tmp_path / "robot.xml").write_text(f"""<mujoco><compiler angle="radian"/><worldbody>
<body><joint {first}/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body><joint {second}/><inertial pos="0.05 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
</body></body></worldbody><actuator>{actuators}</actuator></mujoco>""")
    pd.DataFrame({"time": T, **columns}).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv", deepkoco.load_system(tmp_path / "robot.xml")


ARM = ('name="j1_base" axis="0 0 1"', 'name="j2_elbow" axis="0 1 0"')
SERVOS = '<position name="servo1" joint="j1_base" kp="30"/><position name="servo2" joint="j2_elbow" kp="30"/>'
CART = ('name="cart_slide" type="slide" axis="1 0 0"', 'name="pole_hinge" axis="0 1 0"')
MOTOR = '<motor name="drive" joint="cart_slide"/>'


def read(log, system):
    return read_logs([log], system)[0].channels


def test_the_number_of_a_joint_is_in_its_name(tmp_path):
    late = {f"present_position_{k} [deg]": np.degrees(v) for k, v in ((1, FIRST), (2, SECOND))}
    goals = {
        f"goal_position_{k} [deg]": np.degrees(np.interp(T + 0.03, T, v))
        for k, v in ((1, FIRST), (2, SECOND))
    }
    found = read(*robot(tmp_path, ARM, SERVOS, {**goals, **late}))
    np.testing.assert_allclose(found["q_j2_elbow"].value, SECOND)
    np.testing.assert_allclose(found["servo1"].value, np.interp(T + 0.03, T, FIRST))


def test_one_word_of_a_joint_is_its_name_where_no_other_joint_has_it(tmp_path):
    columns = {"pole_angle [rad]": SECOND, "cart_position [m]": FIRST, "cart_force_cmd [N]": np.cos(5.0 * T)}
    found = read(*robot(tmp_path, CART, MOTOR, columns))
    np.testing.assert_allclose(found["q_cart_slide"].value, FIRST)
    np.testing.assert_allclose(found["q_pole_hinge"].value, SECOND)


def test_a_word_that_two_joints_have_names_none():
    reasons = [m.reason for m in match_joints(["upper", "2"], ["upper_lift", "upper_roll"])]
    assert not any("is in the name" in reason for reason in reasons)
    found = {m.log: (m.model, m.reason) for m in match_joints(["2", "1"], ["j1_base", "j2_elbow"])}
    assert found[0] == (1, '"2" is in the name of "j2_elbow"')
    assert found[1] == (0, '"1" is in the name of "j1_base"')


def test_a_speed_is_found_by_its_values_whatever_it_is_called(tmp_path):
    rates = {"cart_geschw [m/s]": np.gradient(FIRST, T), "pole_vel.": np.gradient(SECOND, T)}
    columns = {"pole_angle [rad]": SECOND, "cart_position [m]": FIRST, "cart_force_cmd [N]": np.cos(5.0 * T)}
    log, system = robot(tmp_path, CART, MOTOR, {**columns, "cart_tempo": np.gradient(FIRST, T)})
    choices = {c.channel.name: c for c in propose(survey_log(open_log(log)), system).proposal.choices}
    assert choices["dq_cart_slide"].column is not None
    assert choices["dq_cart_slide"].column.name == "cart_tempo"
    assert choices["dq_pole_hinge"].column is None
    found = read(*robot(tmp_path, CART, MOTOR, {**columns, **rates}))
    np.testing.assert_allclose(found["dq_cart_slide"].value, np.gradient(FIRST, T))


def test_a_goal_is_no_speed_although_it_is_the_derivative(tmp_path):
    columns = {"pole_angle [rad]": SECOND, "cart_position [m]": FIRST, "cart_force_cmd [N]": np.cos(5.0 * T)}
    log, system = robot(tmp_path, CART, MOTOR, {**columns, "cart_tempo_soll": np.gradient(FIRST, T)})
    choices = {c.channel.name: c for c in propose(survey_log(open_log(log)), system).proposal.choices}
    assert choices["dq_cart_slide"].column is None


LINEAR = '<general name="motor_X" joint="X" gainprm="38.5" biastype="none"/>'


def test_a_current_drives_its_axis_beside_the_goal_of_a_position(tmp_path):
    columns = {
        "Soll_Position_X [mm]": 1e3 * np.interp(T + 0.03, T, FIRST),
        "Ist_Position_X [mm]": 1e3 * FIRST,
        "phi_Y [rad]": SECOND,
        "i_q_X [A]": np.cos(5.0 * T),
    }
    joints = ('name="X" type="slide" axis="1 0 0"', 'name="Y" axis="0 1 0"')
    found = read(*robot(tmp_path, joints, LINEAR, columns))
    np.testing.assert_allclose(found["motor_X"].value, np.cos(5.0 * T))


@pytest.mark.parametrize("name", ["axis_1_motor_torque [Nm]", "Axis_1_MotorTorque [Nm]"])
def test_the_torque_of_a_motor_is_the_number_before_its_gear(tmp_path, name):
    (tmp_path / "wheel.xml").write_text("""<mujoco><worldbody><body><joint name="axis_1" axis="0 0 1"/>
<inertial pos="0 0 0" mass="8" diaginertia="2 2 2"/></body></worldbody>
<actuator><motor name="m1" joint="axis_1" gear="80"/></actuator></mujoco>""")
    torque = -2.0 * (0.4 * 4.0 * np.sin(2.0 * T) + 0.3 * 3.7**2 * np.sin(3.7 * T)) / 80.0
    columns = {"time": T, "axis_1_position [rad]": FIRST, name: torque}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    found = read(tmp_path / "log.csv", deepkoco.load_system(tmp_path / "wheel.xml"))
    np.testing.assert_allclose(found["m1"].value, torque)


def test_a_torque_of_a_joint_behind_a_gear_may_be_either(tmp_path):
    joints = ('name="axis_1" axis="0 0 1"', 'name="axis_2" axis="0 1 0"')
    gear = '<motor name="m1" joint="axis_1" gear="80"/>'
    shown = {"axis_1_position [rad]": FIRST, "axis_2_position [rad]": SECOND}
    with pytest.raises(LogError, match="is in N m, and m1 is in 1"):
        read(*robot(tmp_path, joints, gear, {**shown, "axis_1_torque [Nm]": np.cos(5.0 * T)}))


@pytest.mark.parametrize("name", ["axis_1_angle [V]", "axis_1_vel [V]"])
def test_the_voltage_of_a_sensor_drives_nothing(tmp_path, name):
    joints = ('name="axis_1" axis="0 0 1"', 'name="axis_2" axis="0 1 0"')
    gear = '<motor name="m1" joint="axis_1" gear="5"/>'
    shown = {"axis_1_position [rad]": FIRST, "axis_2_position [rad]": SECOND}
    with pytest.raises(LogError):
        read(*robot(tmp_path, joints, gear, {**shown, name: FIRST}))


@pytest.mark.parametrize(
    ("log", "model"),
    [
        (["0", "1", "2", "3"], ["j1", "j2", "j3"]),
        (["0", "1", "2", "3", "4", "5"], ["j1_base", "j2", "j3", "j4", "j5", "j6"]),
        (["0", "1", "2", "3", "4", "5"], ["pan", "lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]),
        (["j0", "j1"], ["j1_base", "j2_elbow"]),
    ],
)
def test_numbers_that_begin_elsewhere_name_no_joint(log, model):
    matches = match_joints(log, model)
    assert not any("is in the name" in m.reason for m in matches)
    assert all(m.log == m.model for m in matches)


def test_a_number_that_is_called_as_its_drive_is_no_speed(tmp_path):
    joints = ('name="wheel" axis="0 0 1"', 'name="other" axis="0 1 0"')
    drive = '<motor name="wheel_drive" joint="wheel" gear="5"/>'
    columns = {
        "wheel_position [rad]": FIRST,
        "other_position [rad]": SECOND,
        "wheel_drive": np.gradient(FIRST, T),
    }
    log, system = robot(tmp_path, joints, drive, columns)
    choices = {c.channel.name: c for c in propose(survey_log(open_log(log)), system).proposal.choices}
    assert choices["dq_wheel"].column is None
    assert choices["wheel_drive"].column is not None

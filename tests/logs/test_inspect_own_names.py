"""Columns that have the name of an actuator: it says more than the words that it is made of."""

import numpy as np
import pandas as pd
import pytest

import deepkoco
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import propose, survey_log
from deepkoco.logs.read_logs import read_logs
from deepkoco.logs.recording import LogError

T = np.arange(0.0, 8.0, 0.01)
PAN, TILT = np.sin(2.0 * T) + np.sin(3.7 * T), np.cos(0.9 * T) + np.sin(1.3 * T)
SERVOS = '<position name="pan_pos" joint="pan" kp="30" kv="2"/><position name="tilt_pos" joint="tilt" kp="30" kv="2"/>'
MOTORS = '<motor name="pan_motor" joint="pan"/><motor name="tilt_motor" joint="tilt"/>'


def head(tmp_path, actuators, columns):
    """Log and file of a head of two joints."""
    (tmp_path / "head.xml").write_text(f"""<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="pan" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body><joint name="tilt" axis="0 1 0"/><inertial pos="0.05 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
</body></body></worldbody><actuator>{actuators}</actuator></mujoco>""")
    pd.DataFrame({"time": T, **columns}).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv", deepkoco.load_system(tmp_path / "head.xml")


def columns_of(log, robot):
    choices = propose(survey_log(open_log(log)), robot).proposal.choices
    return {c.channel.name: c.column.name for c in choices if c.column is not None}


def late(goal):
    return np.interp(T - 0.03, T, goal)


def test_a_goal_that_is_called_as_its_actuator_is_no_position_although_its_name_says_so(tmp_path):
    shown = {"pan_rad": late(PAN), "tilt_rad": late(TILT)}
    log, robot = head(tmp_path, SERVOS, {"pan_pos_rad": PAN, "tilt_pos_rad": TILT, **shown})
    found = {"q_pan": "pan_rad", "q_tilt": "tilt_rad", "pan_pos": "pan_pos_rad", "tilt_pos": "tilt_pos_rad"}
    assert columns_of(log, robot) == found
    (read,) = read_logs([log], robot)
    np.testing.assert_allclose(read.channels["pan_pos"].value, PAN)


def test_a_column_that_is_called_as_a_servo_is_its_goal_also_without_a_unit(tmp_path):
    servos = SERVOS.replace("pan_pos", "servo1").replace("tilt_pos", "servo2")
    columns = {"pan_rad": late(PAN), "tilt_rad": late(TILT), "servo1": PAN, "servo2": TILT}
    log, robot = head(tmp_path, servos, columns)
    assert columns_of(log, robot) == {
        "q_pan": "pan_rad",
        "q_tilt": "tilt_rad",
        "servo1": "servo1",
        "servo2": "servo2",
    }
    (read,) = read_logs([log], robot)
    np.testing.assert_allclose(read.channels["servo2"].value, TILT)


def test_a_column_that_is_called_as_a_servo_that_nothing_follows_is_no_goal_for_sure(tmp_path):
    servos = SERVOS.replace("pan_pos", "servo1").replace("tilt_pos", "servo2")
    columns = {"pan_rad": late(PAN), "tilt_rad": late(TILT), "servo1": 100.0 * PAN, "servo2": np.cos(7.0 * T)}
    log, robot = head(tmp_path, servos, columns)
    with pytest.raises(LogError, match="is no goal that its position follows in one unit"):
        read_logs([log], robot)


def test_a_position_that_is_called_as_the_actuator_stays_one_where_the_log_has_no_other(tmp_path):
    columns = {"pan_pos_rad": late(PAN), "tilt_pos_rad": late(TILT), "pan_cmd_rad": PAN, "tilt_cmd_rad": TILT}
    found = {
        "q_pan": "pan_pos_rad",
        "q_tilt": "tilt_pos_rad",
        "pan_pos": "pan_cmd_rad",
        "tilt_pos": "tilt_cmd_rad",
    }
    assert columns_of(*head(tmp_path, SERVOS, columns)) == found


@pytest.mark.parametrize("names", ["{}_motor_Nm", "{}_Nm", "{}_torque_Nm"])
def test_the_only_torque_of_a_joint_drives_it_also_where_it_may_be_measured(tmp_path, names):
    shown = {"pan_rad": PAN, "tilt_rad": TILT}
    log, robot = head(
        tmp_path, MOTORS, {names.format("pan"): 0.3 * TILT, names.format("tilt"): 0.3 * PAN, **shown}
    )
    assert columns_of(log, robot)["pan_motor"] == names.format("pan")
    (read,) = read_logs([log], robot)
    np.testing.assert_allclose(read.channels["tilt_motor"].value, 0.3 * PAN)


def test_a_torque_that_may_be_measured_is_not_the_command_beside_a_column_that_may_be(tmp_path):
    shown = {"pan_rad": PAN, "tilt_rad": TILT, "pan_torque_Nm": 0.3 * TILT, "tilt_torque_Nm": 0.3 * PAN}
    log, robot = head(tmp_path, MOTORS, {**shown, "x1": 0.31 * TILT, "x2": 0.31 * PAN})
    with pytest.raises(LogError, match="is measured, and may not be the command pan_motor, beside x1, x2"):
        read_logs([log], robot)


HEIGHT = 0.1 * np.sin(2.0 * T) + 0.05 * np.sin(5.0 * T)
LOAD = 8.0 * (
    9.81 - 0.4 * np.sin(2.0 * T) - 1.25 * np.sin(5.0 * T)
)  # mass times gravity and acceleration [N]


def hoist(tmp_path, gear, columns):
    """Log and file of a hook on a drum."""
    (
        tmp_path / "hoist.xml"
    ).write_text(f"""<mujoco><worldbody><body><joint name="hook" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="8" diaginertia="0.1 0.1 0.1"/></body></worldbody>
<actuator><motor name="hoist_motor" joint="hook" gear="{gear}" ctrlrange="0 {100 / gear}"/></actuator></mujoco>""")
    pd.DataFrame({"t_s": T, **columns}).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv", deepkoco.load_system(tmp_path / "hoist.xml")


def test_a_command_in_newton_is_of_the_actuator_before_its_unit(tmp_path):
    log, robot = hoist(tmp_path, 1, {"hook_pos_m": HEIGHT, "hoist_motor_cmd_N": LOAD})
    (read,) = read_logs([log], robot)
    np.testing.assert_allclose(read.channels["hoist_motor"].value, LOAD)


def test_the_torque_of_a_motor_that_moves_a_slide_is_the_number_of_its_actuator(tmp_path):
    log, robot = hoist(tmp_path, 80, {"hook_height_m": HEIGHT, "hoist_motor_cmd_Nm": LOAD / 80.0})
    (read,) = read_logs([log], robot)
    np.testing.assert_allclose(read.channels["hoist_motor"].value, LOAD / 80.0)
    np.testing.assert_allclose(read.channels["q_hook"].value, HEIGHT)


def test_a_force_on_a_slide_is_not_the_number_of_a_motor_behind_a_gear(tmp_path):
    log, robot = hoist(tmp_path, 80, {"hook_height_m": HEIGHT, "hoist_motor_cmd_N": LOAD})
    with pytest.raises(LogError, match=r"hoist_motor_cmd_N is in N, and hoist_motor is in 1"):
        read_logs([log], robot)

"""Columns that are left: what a recorder writes beside the motion is no channel of a robot."""

import numpy as np
import pandas as pd
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import propose, survey_log
from deepkoco.logs.inspect.fitting import NoProposalError
from deepkoco.logs.inspect.joints.log_joints import role_in_name
from deepkoco.logs.inspect.names import read_name

T = 0.02 * np.arange(1500)
PUSH = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 30), 50)


class Slide(System):
    """A table on a rail."""

    joint_units = "m"
    parameters = (
        Parameter("mass", 2.0, "kg", 0.1, 50.0, 0.1, "m"),
        Parameter("drag", 4.0, "N s/m", 0.0, 50.0, 0.5, "d"),
    )
    commands = (Channel("force", "N", "command", -5.0, 5.0),)
    measurements = (Channel("height", "m", "measurement", noise_sd=1e-4),)

    def accelerations(self, p):
        return lambda motion: (
            (motion.efforts[0] - p["drag"] * motion.speeds[0] + motion.load(0)) / p["mass"],
        )


class Boat(Slide):
    """The same with a log of its speed."""

    measurements = (
        Channel("x", "m", "measurement", noise_sd=1e-2),
        Channel("speed", "m/s", "measurement", noise_sd=1e-2),
    )


def moved():
    x, v = [0.0], [0.0]
    for push in PUSH[:-1]:
        v.append(v[-1] + 0.02 * (push - 4.0 * v[-1]) / 2.0)
        x.append(x[-1] + 0.02 * v[-1])
    return np.array(x), np.array(v)


def survey_of(folder, columns):
    pd.DataFrame({"time": T, "force_cmd_N": PUSH, **columns}).to_csv(folder / "log.csv", index=False)
    return survey_log(open_log(folder / "log.csv"))


@pytest.mark.parametrize("beside", ["temp_C", "bearing_temperature", "pressure", "battery_soc"])
def test_what_a_recorder_writes_beside_the_motion_is_no_height(tmp_path, beside):
    survey = survey_of(tmp_path, {"motor_pos_deg": np.degrees(moved()[0]) * 600.0, beside: 31.0 + T / 60.0})
    with pytest.raises(NoProposalError, match='"motor_pos_deg" is an angle, and height is a length') as told:
        propose(survey, Slide())
    # 5 mm of 360 deg.
    assert "(5 mm a turn: 1.38889e-05)" in str(told.value)


def test_a_name_that_says_nothing_is_still_the_only_one_left(tmp_path):
    found = propose(survey_of(tmp_path, {"thing": moved()[0]}), Slide()).proposal
    assert [c.column and c.column.name for c in found.choices] == ["thing", "force_cmd_N"]


def test_a_speed_called_as_commands_are_is_one_by_its_unit(tmp_path):
    x, v = moved()
    found = propose(survey_of(tmp_path, {"along_track_m": x, "dvl.u_cmps": 100.0 * v}), Boat()).proposal
    assert {c.channel.name: (c.column and c.column.name, c.unit) for c in found.choices} == {
        "x": ("along_track_m", "m"), "speed": ("dvl.u_cmps", "cm/s"), "force": ("force_cmd_N", "N"),
    }  # fmt: skip


def test_cur_is_a_current_where_nothing_else_is_said():
    assert read_name("az_cur_cmd").speaks_for("current") > 0.0
    assert read_name("cur_pos").speaks_for("angle") > 0.0


def test_gyr_is_a_gyro_as_flight_controllers_write_it():
    assert read_name("IMU.GyrZ").speaks_for("angular velocity") > 0.0


@pytest.mark.parametrize("goal", ["target_pos_m", "height_ref_m", "soll_weg_mm"])
def test_a_goal_of_another_unit_than_the_command_is_no_measurement(tmp_path, goal):
    with pytest.raises(NoProposalError):
        propose(survey_of(tmp_path, {goal: moved()[0]}), Slide())


@pytest.mark.parametrize(
    ("name", "role"), [("pan_cur", "effort"), ("pan_cur_pos", "position"), ("pan_current", "effort")]
)
def test_the_current_of_a_joint_is_no_angle_of_it(name, role):
    assert role_in_name(name) == (role, "pan")

"""Units that no name states, where the equations of motion hold in one unit alone; and numbers of drives."""

import mujoco
import numpy as np
import pandas as pd
import pytest

import deepkoco
from deepkoco.cli.command_line import main
from deepkoco.logs.read_logs import read_logs
from deepkoco.logs.recording import LogError

LEG = """<mujoco model="leg"><compiler angle="radian"/><option timestep="0.001"/><worldbody>
<body><joint name="{hip}" axis="0 1 0" damping="0.4"/>
<inertial pos="0 0 -0.2" mass="3" diaginertia="0.06 0.06 0.01"/>
<body pos="0 0 -0.4"><joint name="knee" axis="0 1 0" damping="0.3"/>
<inertial pos="0 0 -0.17" mass="2" diaginertia="0.03 0.03 0.01"/></body></body></worldbody>
<actuator><motor name="hip_motor" joint="{hip}" gear="{gear}"/>
<motor name="knee_motor" joint="knee" gear="{gear}"/></actuator></mujoco>"""
RATE = 200


def moved(gear, hip="hip", seed=5):
    """Times, positions and controls of a leg."""
    model = mujoco.MjModel.from_xml_string(LEG.format(gear=gear, hip=hip))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    t = 3.0 + np.arange(0.0, 12.0, 1.0 / RATE)
    tones, phases = rng.uniform(0.2, 1.2, (3, 2)), rng.uniform(0.0, 2.0 * np.pi, (3, 2))
    rows = []
    for x in t:
        wanted = [0.25, 0.4] * np.sin(2.0 * np.pi * tones * x + phases).sum(0)
        data.ctrl[:] = (25.0 * (wanted - data.qpos) - 3.0 * data.qvel) / gear
        rows.append([*(data.qpos + 2e-4 * rng.normal(size=2)), *data.ctrl])
        mujoco.mj_step(model, data, round(1000 / RATE))
    return t, *np.array(rows).T


def written(tmp_path, columns, gear=1, hip="hip"):
    (tmp_path / "leg.xml").write_text(LEG.format(gear=gear, hip=hip))
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv", deepkoco.load_system(tmp_path / "leg.xml")


def test_angles_and_torques_without_a_unit_are_read_where_the_equations_hold_in_rad_and_newton_metres(
    tmp_path,
):
    t, hip, knee, first, second = moved(1)
    columns = {"stamp": t, "hip_angle": hip, "knee_angle": knee, "hip_torque": first, "knee_torque": second}
    (read,) = read_logs(
        [log := written(tmp_path, columns)[0]], robot := deepkoco.load_system(tmp_path / "leg.xml")
    )
    np.testing.assert_allclose(read.channels["q_knee"].value, knee)
    np.testing.assert_allclose(read.channels["hip_motor"].value, first)
    assert log.is_file()
    assert robot.joints == 2


def test_angles_that_fit_the_equations_in_no_unit_still_ask(tmp_path):
    t, hip, _, first, second = moved(1)
    other = np.sin(5.0 * t) + np.sin(1.3 * t)
    columns = {"stamp": t, "hip_angle": hip, "knee_angle": other, "hip_torque": first, "knee_torque": second}
    log, robot = written(tmp_path, columns)
    with pytest.raises(LogError, match="no name says that"):
        read_logs([log], robot)


@pytest.mark.parametrize(("unit", "size"), [("A", 1.0), ("mA", 1e3)])
def test_a_current_is_the_number_of_its_drive_where_the_equations_hold_with_it(tmp_path, unit, size):
    t, hip, knee, first, second = moved(12)
    columns = {"t [s]": t, "hip [rad]": hip, "knee [rad]": knee}
    columns |= {f"hip current [{unit}]": size * first, f"knee current [{unit}]": size * second}
    (read,) = read_logs([written(tmp_path, columns, 12)[0]], deepkoco.load_system(tmp_path / "leg.xml"))
    np.testing.assert_allclose(read.channels["knee_motor"].value, second)


def test_a_joint_may_have_the_name_of_a_symbol(tmp_path):
    t, hip, knee, first, second = moved(1, hip="phi")
    columns = {"t [s]": t, "phi_act [rad]": hip, "knee [rad]": knee}
    columns |= {"phi_torque_cmd [Nm]": first, "knee_torque_cmd [Nm]": second}
    (read,) = read_logs(
        [written(tmp_path, columns, hip="phi")[0]], deepkoco.load_system(tmp_path / "leg.xml")
    )
    np.testing.assert_allclose(read.channels["q_phi"].value, hip)
    np.testing.assert_allclose(read.channels["hip_motor"].value, first)


def test_a_goal_of_a_position_is_not_what_drives_a_joint_beside_an_effort(tmp_path):
    t, hip, knee, first, second = moved(12)
    columns = {"t [s]": t, "hip [rad]": hip, "knee [rad]": knee, "hip_cmd [rad]": hip + 0.02 * first}
    columns |= {"i_cmd hip [A]": first, "i_cmd knee [A]": second}
    (read,) = read_logs([written(tmp_path, columns, 12)[0]], deepkoco.load_system(tmp_path / "leg.xml"))
    np.testing.assert_allclose(read.channels["hip_motor"].value, first)


WRIST = """<mujoco model="wrist"><compiler angle="radian"/><option timestep="0.001"/><worldbody>
<body><joint name="roll" axis="1 0 0" damping="0.05"/><inertial pos="0 0 0" mass="1" diaginertia="0.02 0.02 0.02"/>
<body><joint name="pitch" axis="0 1 0" damping="0.04"/>
<inertial pos="0 0 0.05" mass="0.6" diaginertia="0.01 0.01 0.01"/></body></body></worldbody>
<actuator><velocity name="roll_vel" joint="roll" kv="0.2"/><velocity name="pitch_vel" joint="pitch" kv="0.15"/>
</actuator></mujoco>"""


def of_velocity_servos(tmp_path, size):
    model = mujoco.MjModel.from_xml_string(WRIST)
    data, rows = mujoco.MjData(model), []
    t = np.arange(0.0, 12.0, 0.005)
    for x in t:
        data.ctrl[:] = 1.2 * np.sin(3.0 * x), 0.9 * np.cos(4.4 * x) + 0.5 * np.sin(1.9 * x)
        rows.append([*data.qpos, *data.qvel, *size * data.ctrl])
        mujoco.mj_step(model, data, 5)
    names = ["roll_pos_rad", "pitch_pos_rad", "roll_speed_rad_s", "pitch_speed_rad_s"]
    columns = dict(zip([*names, "roll_vel_cmd", "pitch_vel_cmd"], np.array(rows).T, strict=True))
    (tmp_path / "wrist.xml").write_text(WRIST)
    pd.DataFrame({"t": t, **columns}).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv", deepkoco.load_system(tmp_path / "wrist.xml")


def test_a_goal_of_a_speed_without_a_unit_is_read_where_the_equations_hold_with_it(tmp_path):
    log, robot = of_velocity_servos(tmp_path, 1.0)
    (read,) = read_logs([log], robot)
    assert read.channels["pitch_vel"].unit == "rad/s"
    np.testing.assert_allclose(read.channels["pitch_vel"].value, pd.read_csv(log)["pitch_vel_cmd"])


def test_a_goal_of_a_speed_in_degrees_asks_for_its_unit(tmp_path):
    log, robot = of_velocity_servos(tmp_path, 180.0 / np.pi)
    with pytest.raises(LogError, match="roll_vel_cmd"):
        read_logs([log], robot)


def test_inspect_says_whether_a_log_needs_a_sidecar(tmp_path, capsys):
    log, _ = of_velocity_servos(tmp_path, 1.0)
    assert main(["inspect", str(log), "--system", str(tmp_path / "wrist.xml")]) == 0
    assert "no sidecar is needed" in capsys.readouterr().out
    of_velocity_servos(tmp_path, 180.0 / np.pi)
    assert main(["inspect", str(log), "--system", str(tmp_path / "wrist.xml")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "write this mapping with" in said
    assert "no name says that roll_vel_cmd is in rad/s" in said
    log.with_suffix(".yaml").write_text("channels: {}")
    assert main(["inspect", str(log), "--system", str(tmp_path / "wrist.xml")]) == 2
    assert "no sidecar is needed" not in capsys.readouterr().out


CELL = """<mujoco model="cell"><option timestep="0.001"/><worldbody>
<body><joint name="rail" type="slide" axis="1 0 0" damping="6"/><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
<body><joint name="turn" axis="0 0 1" damping="0.04"/>
<inertial pos="0 0 0" mass="0.6" diaginertia="0.01 0.01 0.01"/></body></body></worldbody>
<actuator><velocity name="rail_vel" joint="rail" kv="30"/><velocity name="turn_vel" joint="turn" kv="0.1"/>
</actuator></mujoco>"""


@pytest.mark.parametrize("size", [1.0, 180.0 / np.pi])
def test_goals_of_speeds_of_slides_do_not_vouch_for_those_of_joints_that_turn(tmp_path, size):
    model = mujoco.MjModel.from_xml_string(CELL)
    data, rows = mujoco.MjData(model), []
    t = np.arange(0.0, 12.0, 0.005)
    for x in t:
        data.ctrl[:] = 0.3 * np.sin(3.0 * x), 1.4 * np.cos(4.4 * x) + 0.5 * np.sin(1.9 * x)
        rows.append([*data.qpos, data.ctrl[0], size * data.ctrl[1]])
        mujoco.mj_step(model, data, 5)
    names = ["rail_pos_m", "turn_pos_rad", "rail_vel_cmd", "turn_vel_cmd"]
    pd.DataFrame({"t": t, **dict(zip(names, np.array(rows).T, strict=True))}).to_csv(
        tmp_path / "log.csv", index=False
    )
    (tmp_path / "cell.xml").write_text(CELL)
    robot = deepkoco.load_system(tmp_path / "cell.xml")
    if size == 1.0:
        (read,) = read_logs([tmp_path / "log.csv"], robot)
        assert {read.channels[n].unit for n in ("rail_vel", "turn_vel")} == {"m/s", "rad/s"}
    else:
        with pytest.raises(LogError, match="_vel_cmd is in"):
            read_logs([tmp_path / "log.csv"], robot)

"""Proposed mappings of logs of robots that are classes of their users: names of single channels, goals, refusals."""

import json

import numpy as np
import pandas as pd
import pytest
from mcap.writer import Writer

from deepkoco import Channel, Parameter, System
from deepkoco.cli.command_line import main
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import NoProposalError, doubts_of, propose, survey_log
from deepkoco.logs.inspect.names import read_name
from deepkoco.logs.read_logs import read_logs
from deepkoco.logs.recording import LogError, read_log

T = np.arange(0.0, 8.0, 0.01)
FAST, SLOW = np.sin(2.0 * T) + np.sin(3.7 * T), np.cos(0.9 * T) + np.sin(1.3 * T)


def channels(system):
    class Robot(System):
        parameters = (Parameter("inertia", 1.0, "kg m2", 0.1, 10.0, 0.1, "J"),)
        joint_units, joint_names = system["units"], system["names"]
        command_joints = system["driven"]
        commands = tuple(Channel(n, unit, "command", -1.0, 1.0) for n, unit in system["commands"])
        measurements = tuple(
            Channel(n, u, "measurement", noise_sd=1e-3)
            for n, u in zip(system["shown"], system["units"], strict=True)
        )

        def accelerations(self, p):
            def law(motion):
                drive = sum(motion.efforts)
                return tuple((drive + motion.load(k)) / p["inertia"] for k in range(self.joints))

            return law

    return Robot()


DRIVE = {
    "units": ("rad", "rad"),
    "names": ("motor", "load"),
    "shown": ("motor_angle", "load_angle"),
    "commands": (("current", "A"),),
    "driven": (0,),
}
ARM = {
    "units": ("rad", "rad"),
    "names": ("shoulder", "elbow"),
    "shown": ("shoulder", "elbow"),
    "commands": (("goal_shoulder", "rad"), ("goal_elbow", "rad")),
    "driven": (0, 1),
}
SEESAW = {
    "units": ("rad",),
    "names": ("roll",),
    "shown": ("roll",),
    "commands": (("left", "1"), ("right", "1")),
    "driven": (0, 0),
}


STEERED = {
    "units": ("rad", "rad"),
    "names": ("lean", "steer"),
    "shown": ("lean_angle", "steer_angle"),
    "commands": (("steer_torque", "N m"),),
    "driven": (1,),
}


def columns(tmp_path, frame, system):
    path = tmp_path / "log.csv"
    pd.DataFrame(frame).to_csv(path, index=False)
    proposal = propose(survey_log(open_log(path)), channels(system)).proposal
    return {c.channel.name: None if c.column is None else (c.column.name, c.unit) for c in proposal.choices}


def test_joints_of_a_message_go_to_the_channels_of_their_names_in_any_order(tmp_path):
    frame = {"t": T, "position[load]": 0.2 * SLOW, "position[motor]": FAST, "current_A": np.gradient(FAST, T)}
    found = columns(tmp_path, frame, DRIVE)
    assert (found["motor_angle"][0], found["load_angle"][0]) == ("position[motor]", "position[load]")


def test_two_actuators_of_one_joint_are_told_apart_by_the_letters_of_their_sides(tmp_path):
    frame = {
        "t": T,
        "throttle_R_pct": 40 + 20 * FAST,
        "throttle_L_pct": 40 - 20 * FAST,
        "roll_deg": 30 * SLOW,
    }
    found = columns(tmp_path, frame, SEESAW)
    assert found == {
        "roll": ("roll_deg", "deg"),
        "left": ("throttle_L_pct", "%"),
        "right": ("throttle_R_pct", "%"),
    }


def test_goals_without_names_go_to_the_joints_that_follow_them(tmp_path):
    motion = {"elbow": np.sin(5.0 * T) + np.sin(9.3 * T), "shoulder": np.cos(1.9 * T) + np.sin(3.1 * T)}
    late = {f"position[{k}]": np.interp(T - 0.05, T, v) for k, v in motion.items()}
    found = columns(
        tmp_path, {"t": T, "cmd.data[0]": motion["elbow"], "cmd.data[1]": motion["shoulder"], **late}, ARM
    )
    assert found["goal_elbow"][0] == "cmd.data[0]"
    assert found["goal_shoulder"][0] == "cmd.data[1]"
    assert found["elbow"][0] == "position[elbow]"


@pytest.mark.parametrize(("size", "asked"), [(4000.0, True), (4000.5, False)])
def test_whole_numbers_without_a_unit_are_asked_for_as_counts_of_an_encoder(tmp_path, size, asked):
    counts = np.round(size * FAST) if asked else size * FAST
    pd.DataFrame({"t": T, "enc_motor": counts, "load_deg": SLOW, "current_A": FAST}).to_csv(
        tmp_path / "log.csv", index=False
    )
    survey = survey_log(open_log(tmp_path / "log.csv"))
    doubts = doubts_of(survey, propose(survey, channels(DRIVE)).proposal)
    said = [d for d in doubts if "counts of an encoder" in d]
    assert len(said) == asked
    assert all("enc_motor" in d and "2 pi / (counts per turn)" in d for d in said)
    assert not any("offset" in d for d in said)


def test_counts_that_never_pass_zero_need_an_offset_too(tmp_path):
    # An absolute encoder that stands at 31207 where the model's angle is 0.
    frame = pd.DataFrame(
        {"t": T, "enc_motor": np.round(31207.0 + 4000.0 * FAST), "load_deg": SLOW, "current_A": FAST}
    )
    frame.to_csv(tmp_path / "log.csv", index=False)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    (said,) = (d for d in doubts_of(survey, propose(survey, channels(DRIVE)).proposal) if "counts of" in d)
    assert "and as offset minus the scale times the count at which motor_angle is 0" in said


@pytest.mark.parametrize(("name", "unit"), [("gap_um", "um"), ("gap [um]", "um"), ("gap_mm", "mm")])
def test_micrometres_in_a_name_are_understood(tmp_path, name, unit):
    system = {**DRIVE, "units": ("m",), "names": ("gap",), "shown": ("gap",)}
    found = columns(tmp_path, {"t": T, name: 9000 + 100 * SLOW, "current_mA": 1000 * FAST}, system)
    assert found == {"gap": (name, unit), "current": ("current_mA", "mA")}


def test_the_columns_are_shown_where_no_mapping_can_be_written(tmp_path, capsys):
    pd.DataFrame({"t": T, "foo": FAST}).to_csv(tmp_path / "log.csv", index=False)
    out = tmp_path / "map.yaml"
    assert main(["inspect", str(tmp_path / "log.csv"), "--system", "rod_pendulum", "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert "foo" in said.out
    assert "no column fits the channel" in said.err
    assert "written" not in said.out
    assert not out.exists()


@pytest.mark.parametrize(("kind", "unit"), [("sensor_msgs/JointState", "rad"), ("my/State", "deg")])
def test_joint_states_are_in_radians_by_their_definition_however_far_a_motor_turns(tmp_path, kind, unit):
    path = tmp_path / "log.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        state, command = (
            writer.register_channel(topic, "json", writer.register_schema(name, "jsonschema", b"{}"))
            for topic, name in (("/joint_states", kind), ("/cmd", "my/Command"))
        )
        for now, motor, load in zip(T, 200.0 * FAST, 0.3 * SLOW, strict=True):
            stamp = int(1e9 * now)
            said = {"name": ["load", "motor"], "position": [load, motor]}
            writer.add_message(state, stamp, json.dumps(said).encode(), stamp)
            writer.add_message(command, stamp, json.dumps({"current_A": motor / 200.0}).encode(), stamp)
        writer.finish()
    proposal = propose(survey_log(open_log(path)), channels(DRIVE)).proposal
    assert {c.channel.name: c.unit for c in proposal.choices}["motor_angle"] == unit


def test_short_symbols_of_forces_and_torques_are_understood(tmp_path):
    quad = {**SEESAW, "commands": (("thrust_left", "N"), ("thrust_right", "N"))}
    found = columns(tmp_path, {"t": T, "F_R": 4 + FAST, "F_L": 4 - FAST, "roll_deg": 30 * SLOW}, quad)
    assert (found["thrust_left"][0], found["thrust_right"][0]) == ("F_L", "F_R")


def test_a_column_whose_name_says_nothing_is_a_guess_for_the_only_channel_without_one(tmp_path):
    frame = {"ms": 1000 * T, "lean_deg": 9 * SLOW, "foo": 0.3 * FAST, "T_steer": FAST}
    found = columns(tmp_path, frame, STEERED)
    assert found == {
        "lean_angle": ("lean_deg", "deg"),
        "steer_angle": ("foo", "rad"),
        "steer_torque": ("T_steer", "N m"),
    }
    more = columns(tmp_path, {**frame, "bar": SLOW}, STEERED)
    assert more["steer_angle"] is None  # two columns could be it


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "rad"), (180 / np.pi, "deg")])
def test_an_angle_without_a_unit_has_the_one_in_which_the_equations_hold(tmp_path, factor, unit):
    torque = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, len(T) // 40), 40)
    speed = np.cumsum(torque) * 0.01
    angle = np.cumsum(speed) * 0.01  # 1 rad/s2 for each N m
    system = {**STEERED, "units": ("rad",), "names": ("tilt",), "shown": ("tilt",), "driven": (0,)}
    found = columns(tmp_path, {"t": T, "tilt": factor * angle, "torque_Nm": torque}, system)
    assert found["tilt"] == ("tilt", unit)


@pytest.mark.parametrize(
    ("name", "unit"), [("ms", "ms"), ("us", "us"), ("millis", "ms"), ("uptime_ms", "ms")]
)
def test_a_time_may_be_called_by_its_unit(tmp_path, name, unit):
    scale = {"ms": 1e3, "us": 1e6}[unit]
    pd.DataFrame({name: scale * T + rough(T), "foo": FAST}).to_csv(tmp_path / "log.csv", index=False)
    clock = survey_log(open_log(tmp_path / "log.csv")).clocks[""][0]
    assert (clock.column, clock.unit) == (name, unit)


def rough(t):
    return np.random.default_rng(0).uniform(0.0, 4.0, len(t))


@pytest.mark.parametrize("name", ["ts", "Zeit", "recorded"])
def test_text_that_reads_as_dates_is_a_time_under_any_name(tmp_path, name):
    stamps = pd.to_datetime(1764060000 + T, unit="s").strftime("%H:%M:%S.%f")
    frame = {name: stamps, "angle_deg": 9 * SLOW, "torque_Nm": FAST, "mode": "auto"}
    found = columns(
        tmp_path,
        frame,
        {**STEERED, "units": ("rad",), "names": ("tilt",), "shown": ("angle",), "driven": (0,)},
    )
    assert found == {"angle": ("angle_deg", "deg"), "steer_torque": ("torque_Nm", "N m")}


@pytest.mark.parametrize(
    ("factor", "asked"), [(180 / np.pi, "values suggest deg"), (1000.0, "check its unit (mrad)")]
)
def test_a_command_far_above_its_limit_has_the_unit_that_brings_it_below_or_is_asked_for_it(
    tmp_path, factor, asked
):
    frame = {"t": T, "tilt": 0.4 * np.roll(FAST, 5), "goal": 0.4 * factor * FAST}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    servo = {
        "units": ("rad",),
        "names": ("tilt",),
        "shown": ("tilt",),
        "driven": (0,),
        "commands": (("goal", "rad"),),
    }
    survey = survey_log(open_log(tmp_path / "log.csv"))
    doubts = doubts_of(survey, propose(survey, channels(servo)).proposal)
    assert any('"goal"' in d and asked in d for d in doubts)


def test_a_command_in_the_steps_of_a_driver_is_asked_for_its_scale(tmp_path):
    """A mere number has no smaller unit than per cent; 16 bits are the full scale of many drivers."""
    frame = {"t": T, "tilt": 0.4 * np.roll(FAST, 5), "motor_cmd": np.round(32767 * FAST / np.abs(FAST).max())}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    drive = {
        "units": ("rad",),
        "names": ("tilt",),
        "shown": ("tilt",),
        "driven": (0,),
        "commands": (("drive", "1"),),
    }
    survey = survey_log(open_log(tmp_path / "log.csv"))
    system = channels(drive)
    doubts = doubts_of(survey, propose(survey, system).proposal)
    limit = system.commands[0].high
    (doubt,) = [d for d in doubts if "times the limit" in d]
    assert "check its unit (%)" in doubt
    assert f"{limit / 32767:.6g} makes its largest value the limit" in doubt


class WheelPendulum(System):
    """A pendulum with a reaction wheel, of which the speed is measured and not the angle."""

    joint_names, joint_units = ("body", "wheel"), ("rad", "rad")
    parameters = (Parameter("inertia", 1.0, "kg m2", 0.1, 10.0, 0.1, "J"),)
    commands = (Channel("current", "A", "command", -5.0, 5.0),)
    measurements = (
        Channel("tilt", "rad", "measurement", noise_sd=1e-3),
        Channel("wheel_speed", "rad/s", "measurement", noise_sd=0.1),
    )
    measured_states = (0, 3)

    def ideal_measurement(self, state):
        return state[..., [0, 3]]

    def accelerations(self, p):
        return lambda m: (
            (m.load(0) - m.efforts[0]) / p["inertia"],
            (m.load(1) + m.efforts[0]) / p["inertia"],
        )


def test_an_angle_and_the_speed_of_another_joint_are_not_compared(tmp_path):
    log = tmp_path / "wheel.csv"
    table = {"t": T, "i [A]": SLOW, "body [deg]": np.degrees(FAST), "rotor [rpm]": 300.0 * SLOW + 40.0 * FAST}
    pd.DataFrame(table).to_csv(log, index=False)
    system = WheelPendulum()
    assert system.shows_states
    assert system.speeds_of_positions == ()
    found = {c.channel.name: c.unit for c in propose(survey_log(open_log(log)), system).proposal.choices}
    assert found == {"tilt": "deg", "wheel_speed": "rpm", "current": "A"}
    mapping = {
        "time": {"column": "t", "unit": "s"},
        "channels": {
            "current": {"column": "i [A]", "unit": "A", "kind": "command"},
            "tilt": {"column": "body [deg]", "unit": "deg", "kind": "measurement"},
            "wheel_speed": {"column": "rotor [rpm]", "unit": "rpm", "kind": "measurement"},
        },
    }
    (recording,) = read_logs(log, system, mapping=mapping)
    assert recording.names("measurement") == ("tilt", "wheel_speed")
    with pytest.raises(LogError, match="not the derivative"):
        read_log(log, mapping)


def test_goal_and_measurement_are_told_apart_by_their_german_words():
    for goal, measured in (("v_soll[m/s]", "v_ist[mm/s]"), ("Sollwert [mm]", "Istwert [mm]")):
        assert read_name(goal).wanted
        assert not read_name(goal).measured
        assert read_name(measured).measured
        assert not read_name(measured).wanted
    assert read_name("Drehmoment [Nm]").speaks_for("torque") > 0.0
    assert read_name("Winkel [°]").speaks_for("angle") > 0.0


@pytest.mark.parametrize(
    ("name", "unit"), [("v_soll_m/min", "m/min"), ("feed [mm/min]", "mm/min"), ("ist_grad", "deg")]
)
def test_units_of_machines_are_understood(name, unit):
    assert read_name(name).unit == unit


def test_a_log_without_the_command_that_a_system_needs_is_still_refused(tmp_path):
    pd.DataFrame({"t": T, "motor_angle": FAST, "load_angle": SLOW}).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(NoProposalError, match="no column fits the channel current"):
        propose(survey_log(open_log(tmp_path / "log.csv")), channels(DRIVE))


class Conveyor(System):
    """A belt whose inverter follows goals of its speed; the drum's speed is declared as that of the belt."""

    joint_names, joint_units = ("belt",), ("m",)
    parameters = (Parameter("control", 5.0, "1/s", 0.1, 50.0, 0.5, "speed controller per mass"),)
    commands = (Channel("goal", "m/s", "command", -2.0, 2.0),)
    measurements = (
        Channel("way", "m", "measurement", noise_sd=2e-4),
        Channel("drum", "m/s", "measurement", noise_sd=2e-3),
    )

    def accelerations(self, p):
        return lambda s: (p["control"] * (s.efforts[0] - s.speeds[0]) + s.load(0),)


def test_the_goal_of_a_speed_is_no_measured_speed_although_the_position_follows_it(tmp_path):
    goal = np.repeat(np.random.default_rng(0).uniform(-0.6, 0.6, len(T) // 40), 40)
    speed, way = np.zeros(len(goal)), np.zeros(len(goal))
    for k in range(1, len(goal)):
        speed[k] = speed[k - 1] + 0.05 * (goal[k - 1] - speed[k - 1])
        way[k] = way[k - 1] + 0.01 * speed[k - 1]
    frame = {"time_s": 0.01 * np.arange(len(goal)), "v_set_mm/s": 1e3 * goal, "belt_mm": 1e3 * way}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    proposal = propose(survey_log(open_log(tmp_path / "log.csv")), Conveyor()).proposal
    found = {c.channel.name: None if c.column is None else c.column.name for c in proposal.choices}
    assert found == {"way": "belt_mm", "drum": None, "goal": "v_set_mm/s"}

# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""Proposed mappings of columns in counts: ticks of a turn, counts of encoders, goals in numbers of their own."""

import re

import numpy as np
import pandas as pd
import pytest
from test_inspect_own_robots import STEERED, T, channels

from deepkoco import Channel, Parameter, System
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import doubts_of, propose, survey_log


def servo_of_ticks(turns):
    """Goals and positions of a servo [rad] that follows in 0.2 s, over some turns."""
    rng = np.random.default_rng(0)
    goal = turns * np.pi * (1.0 + np.repeat(rng.uniform(-1.0, 1.0, len(T) // 40), 40))
    position = np.zeros(len(T))
    for k in range(1, len(T)):
        position[k] = position[k - 1] + 0.05 * (goal[k - 1] - position[k - 1])
    return goal, position


@pytest.mark.parametrize("turns", [1.0, 3.0])
def test_a_position_that_begins_again_after_its_ticks_is_read_in_them_with_its_goal(tmp_path, turns):
    goal, position = (np.floor(v / (2 * np.pi) * 4096) for v in servo_of_ticks(turns))
    servo = {**STEERED, "units": ("rad",), "names": ("table",), "shown": ("place",), "driven": (0,)}
    servo["commands"] = (("goal", "rad"),)
    frame = {"t": T, "Goal_Position": goal, "Present_Position": position % 4096}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    proposal = propose(survey, channels(servo)).proposal
    wraps = bool(np.any(np.abs(np.diff(position % 4096)) > 3000))
    assert wraps == (turns > 1.0)
    if wraps:
        assert [c.scale for c in proposal.choices] == pytest.approx([2 * np.pi / 4096] * 2)
    told = any("begins again after 4096" in doubt for doubt in doubts_of(survey, proposal))
    assert told == wraps


def test_counts_of_an_encoder_have_the_turn_with_which_the_equations_hold(tmp_path):
    torque = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, len(T) // 40), 40)
    angle = np.cumsum(np.cumsum(torque) * 0.01) * 0.01  # 1 rad/s2 for each N m
    system = {**STEERED, "units": ("rad",), "names": ("shaft",), "shown": ("shaft",), "driven": (0,)}
    frame = {"t": T, "enc": np.floor(angle / (2 * np.pi) * 4096), "torque_Nm": torque}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    proposal = propose(survey, channels(system)).proposal
    shaft = next(c for c in proposal.choices if c.channel.name == "shaft")
    assert round(2 * np.pi / shaft.scale) in (4000, 4096)  # 2 % are less than a description is off
    (said,) = [doubt for doubt in doubts_of(survey, proposal) if "whole numbers" in doubt]
    assert "4000" in said
    assert "4096" in said


def test_the_turns_that_fit_about_as_well_are_told_of_their_own_encoder(tmp_path):
    class Pair(System):
        parameters = (Parameter("inertia", 1.0, "kg m2", 0.1, 10.0, 0.1, "J"),)
        joint_units, joint_names, command_joints = ("rad", "rad"), ("left", "right"), (0, 1)
        commands = tuple(Channel(f"torque_{n}", "N m", "command", -1.0, 1.0) for n in joint_names)
        measurements = tuple(Channel(n, "rad", "measurement", noise_sd=1e-3) for n in joint_names)

        def accelerations(self, p):
            return lambda m: tuple((m.efforts[k] + m.load(k)) / p["inertia"] for k in range(2))

    frame, rng = {"t": T}, np.random.default_rng(0)
    for name, turn in (("left", 4096), ("right", 2048)):
        torque = np.repeat(rng.uniform(-1.0, 1.0, len(T) // 40), 40)
        angle = np.cumsum(np.cumsum(torque) * 0.01) * 0.01  # 1 rad/s2 for each N m
        frame |= {f"enc_{name}": np.floor(angle / (2 * np.pi) * turn), f"torque_{name}_Nm": torque}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    doubts = doubts_of(survey, propose(survey, Pair()).proposal)
    told = {
        name: {
            int(number)
            for doubt in doubts
            if f"enc_{name}" in doubt
            for number in re.findall(r"\d{4,}", doubt)
        }
        for name in ("left", "right")
    }
    for name, turn in (("left", 4096), ("right", 2048)):
        assert turn in told[name]
        assert all(0.8 < number / turn < 1.25 for number in told[name])


class Servo(System):
    parameters = (Parameter("pace", 6.0, "rad/s", 1.0, 20.0, 0.5, "natural frequency"),)
    joint_units = ("rad",)
    commands = (Channel("goal", "rad", "command", -2.7, 2.7),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        n = p["pace"]
        return lambda s: (n**2 * (s.efforts[0] - s.angles[0]) - 2.0 * n * s.speeds[0] + s.load(0),)


def angle_after(goal, step):
    """Angles of the servo above [rad] at goals [rad] in steps of time [s]."""
    angle, speed = np.zeros(len(goal)), 0.0
    for k in range(1, len(goal)):
        speed += step * (36.0 * (goal[k - 1] - angle[k - 1]) - 12.0 * speed)
        angle[k] = angle[k - 1] + step * speed
    return angle


def test_a_goal_without_a_unit_has_the_one_in_which_the_equations_hold(tmp_path):
    goal = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, len(T) // 40), 40)
    frame = {"t": T, "soll": np.degrees(goal), "angle": np.degrees(angle_after(goal, 0.01))}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    proposal = propose(survey_log(open_log(tmp_path / "log.csv")), Servo()).proposal
    assert {c.channel.name: c.unit for c in proposal.choices} == {"goal": "deg", "angle": "deg"}


@pytest.mark.parametrize("zero", [0, 512])
def test_steps_of_a_goal_are_no_turns_and_its_ticks_those_with_which_the_equations_hold(tmp_path, zero):
    """1024 numbers over 300 deg; the angle 0 is the first of them, or that in the middle."""
    goal = np.repeat(np.random.default_rng(0).integers(0, 1024 if zero else 512, 100), 40)
    tick = np.radians(300.0) / 1024
    angle = angle_after(tick * (goal - zero), 0.01)
    frame = {"t": 0.01 * np.arange(len(goal)), "soll": goal, "angle [rad]": angle}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    proposal = propose(survey, Servo()).proposal
    soll = next(c for c in proposal.choices if c.channel.name == "goal")
    assert soll.scale == pytest.approx(tick, rel=0.01)
    assert soll.offset == pytest.approx(-tick * zero, rel=0.01)
    assert any('"soll"' in doubt for doubt in doubts_of(survey, proposal))
    assert not any("begins again" in reason for reason in soll.reasons)


def test_ticks_around_their_middle_are_told_by_the_limits_where_the_description_is_far_off(tmp_path):
    class Servo(System):
        """Its stiffness is not that of the log by far, so the equations hold in no unit."""

        joint_units, joint_names = ("rad",), ("pan",)
        parameters = (Parameter("stiffness", 4000.0, "1/s^2", 1.0, 1e5, 100.0, "over the inertia"),)
        commands = (Channel("goal", "rad", "command", -3.2, 3.2),)
        measurements = (Channel("pan", "rad", "measurement", noise_sd=1e-3, angle=True),)

        def accelerations(self, p):
            return lambda m: (p["stiffness"] * (m.efforts[0] - m.angles[0]) + m.load(0),)

    goal = np.repeat(np.random.default_rng(3).uniform(-1.2, 1.2, len(T) // 40), 40)
    angle, speed = np.zeros(len(T)), 0.0
    for k in range(1, len(T)):
        speed += 0.01 * (30.0 * (goal[k - 1] - angle[k - 1]) - 8.0 * speed)
        angle[k] = angle[k - 1] + 0.01 * speed
    frame = {"t": T}
    for name, value in (("goal_position", goal), ("present_position", angle)):
        frame[name] = np.round(value / (2 * np.pi) * 4096 + 2048).astype(int)
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    proposal = propose(survey_log(open_log(tmp_path / "log.csv")), Servo()).proposal
    for choice in proposal.choices:
        assert choice.scale == pytest.approx(2 * np.pi / 4096)
        assert choice.offset == pytest.approx(-np.pi)
        assert any("beyond their limits" in reason for reason in choice.reasons)


class Flywheel(System):
    """A wheel whose encoder and tachometer are logged."""

    parameters = (Parameter("inertia", 1.0, "kg m2", 0.1, 10.0, 0.1, "J"),)
    joint_units, joint_names = ("rad",), ("wheel",)
    commands = (Channel("torque", "N m", "command", -1.0, 1.0),)
    measurements = (
        Channel("angle", "rad", "measurement", noise_sd=1e-3),
        Channel("speed", "rad/s", "measurement", noise_sd=1e-2),
    )

    def accelerations(self, p):
        return lambda m: ((m.efforts[0] + m.load(0)) / p["inertia"],)


@pytest.mark.parametrize(("turn", "told"), [(2000, 2000), (2048, 2048), (2300, None)])
def test_a_speed_with_its_unit_tells_how_many_counts_are_a_turn(tmp_path, turn, told):
    """2300 counts are of no usual encoder: a gear may be between the sensors, so that stays for the user to write."""
    torque = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, len(T) // 40), 40)
    speed = np.cumsum(60.0 * torque) * 0.01  # 60 times what the description says: no equation is asked
    angle = np.cumsum(speed) * 0.01
    frame = {
        "t": T,
        "enc_counts": np.floor(angle / (2 * np.pi) * turn),
        "speed_rpm": np.round(speed * 30 / np.pi),
        "torque_Nm": torque,
    }
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    proposal = propose(survey, Flywheel()).proposal
    shaft = next(c for c in proposal.choices if c.channel.name == "angle")
    doubts = [doubt for doubt in doubts_of(survey, proposal) if "enc_counts" in doubt]
    if told is None:
        assert shaft.scale == 1.0
        assert any("not by 1" in doubt for doubt in doubts)
    else:
        assert shaft.scale == pytest.approx(2 * np.pi / told)
        assert not any("not by 1" in doubt for doubt in doubts)
        assert any(f"shows {told} of them" in doubt for doubt in doubts)

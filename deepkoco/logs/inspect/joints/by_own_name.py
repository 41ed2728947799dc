"""Columns that are called as an actuator or a joint, where the joints of the log have none for a channel."""

from __future__ import annotations

import re

from deepkoco.logs.by_name import wanted_names
from deepkoco.logs.inspect.choice import Choice
from deepkoco.logs.inspect.evidence import SPEEDS
from deepkoco.logs.inspect.joints.log_joints import GOALS, LogJoint, role_in_name, role_of
from deepkoco.logs.inspect.joints.match import SAME_NAME
from deepkoco.logs.inspect.names import unit_suffix
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel, System

EFFORT_GOALS = (GOALS["effort"],)
NAMED = 0.95  # probability that a column with the name of an actuator or a joint is its channel


def called_as_actuators(survey: Survey, system: System) -> dict[int, ColumnSurvey]:
    """Columns that have the name of an actuator and no joint's, and a unit of its command: ``elbow_pos_rad``.

    The name of an actuator may hold words that say something else of a column: `pos` a measured position, a unit of
    torque a measured effort. A name that the user gave says more than they do. Where it holds no such words, as
    ``servo1``, no unit is needed.

    Args:
        survey: Of the log.
        system: The system.

    Returns:
        Number of the command -> column.
    """
    joints = {name.lower() for name in system.joint_names}
    found = {}
    for number, channel in enumerate(system.commands[: len(system.command_joints)]):
        own = [
            column
            for column in survey.columns
            if column.usable
            and _may_have_unit_of(column, channel)
            and _without_unit(column, channel) == channel.name.lower()
        ]
        if len(own) == 1 and channel.name.lower() not in joints:
            found[number] = own[0]
    return found


def _may_have_unit_of(column: ColumnSurvey, channel: Channel) -> bool:
    """Whether a column has a unit of a channel's quantity; one without a unit, whether its name says no quantity."""
    if column.hints.unit is None:
        return role_of(column)[0] is None
    return parse_unit(column.hints.unit).quantity == parse_unit(channel.unit).quantity


def give_commands(called: dict[int, ColumnSurvey], joints: dict[int, LogJoint], system: System) -> None:
    """Give the columns that are called as actuators to the joints that these drive, where no other is their command.

    Args:
        called: Number of a command -> column.
        joints: Number of a joint of the model -> its columns, which change.
        system: The system.
    """
    for number, column in called.items():
        driven = system.command_joints[number]
        if driven not in joints:
            continue
        unit = system.commands[number].unit
        speed = parse_unit(unit).quantity in SPEEDS
        role = "goal" if unit == system.state_units[driven] else "goal speed" if speed else "goal effort"
        joints[driven].columns.setdefault(role, column)


def command_by_name(
    survey: Survey, choice: Choice, shown: set[str], joint: str = "", efforts: bool = False
) -> Choice:
    """A command without a column, with the one that has its name: that of the actuator, alone or behind `cmd_`.

    Else the one of which all words but those for a goal are the actuator's: ``drive_cmd``, ``m_elbow_setpoint``; or
    those of the joint that it drives: ``reach_cmd_Nm`` of ``reach_drive``.

    Args:
        survey: Of the log.
        choice: For the command.
        shown: Labels of the columns that are measurements.
        joint: Name of the joint that no other command drives; empty if there is none.
        efforts: Whether the log has efforts without the name of a joint. What drives a joint in a unit of its own is
            then one of them, and no goal of a position.
    """
    if choice.column is not None:
        return choice
    names = {name.lower() for name in wanted_names(choice.channel.name, "command")}
    free = [column for column in survey.columns if column.usable and column.label not in shown]
    exact = [c for c in free if _without_unit(c, choice.channel) in names]
    asked: list[ColumnSurvey] = []
    for own in (role_in_name(choice.channel.name)[1], role_in_name(joint)[1]):
        own_goals = GOALS.values() if not efforts or choice.channel.unit != "1" else EFFORT_GOALS
        asked = asked or [c for c in free if own and role_of(c) in {(goal, own) for goal in own_goals}]
    if not exact and len(asked) != 1:
        return choice
    column = (exact or asked)[0]
    unit = column.hints.unit
    return Choice(choice.channel, column, unit or choice.channel.unit, unit is not None, NAMED, (SAME_NAME,))


def _without_unit(column: ColumnSurvey, channel: Channel) -> str:
    """The name of a column in lower case, without a unit of the channel at its end: ``trolley_motor_N`` for a force.

    The same letter counts joints where the channel is no force: the whole name is then kept.
    """
    name = re.sub(r"\s*[\[(][^\[\]()]*[\])]\s*$", "", column.name).strip().lower()
    unit = column.hints.unit
    if unit is None or parse_unit(unit).quantity != parse_unit(channel.unit).quantity:
        return name
    parts = [part for part in re.split(r"[^A-Za-z0-9°%]+", column.name) if part]
    ahead, _ = unit_suffix(parts, column.name)
    return "_".join(ahead).lower()


def speed_by_name(survey: Survey, choice: Choice, placed: set[int], system: System) -> Choice:
    """A speed without a column, with the one that is called as its joint: a gyro or a tachometer without a position.

    Args:
        survey: Of the log.
        choice: For a measurement.
        placed: Numbers of the joints of which the log shows the position.
        system: The system.
    """
    name = choice.channel.name
    joint = next((j for j, own in enumerate(system.joint_names) if name == f"dq_{own}"), None)
    if choice.column is not None or joint is None or joint in placed:
        return choice
    label, quantity = role_in_name(system.joint_names[joint])[1], parse_unit(choice.channel.unit).quantity
    found = []
    for column in survey.columns:
        unit = column.hints.unit
        exact = unit is None and column.name.strip().lower() == name.lower()
        if column.usable and (exact or (role_of(column) == ("speed", label) and unit is not None)):
            unit = choice.channel.unit if unit is None else unit
            if parse_unit(unit).quantity == quantity:
                found.append(Choice(choice.channel, column, unit, True, NAMED, (SAME_NAME,)))
    return found[0] if len(found) == 1 else choice

"""Speeds whose names say none in words that are known: `A1.ActVelo`, `Z_geschw`; their values do."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from deepkoco.logs.by_name import wanted_names
from deepkoco.logs.checks.derivative import relate
from deepkoco.logs.inspect.evidence import SPEEDS
from deepkoco.logs.inspect.joints.log_joints import EFFORT, GOAL, POSITION, LogJoint, words_of
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel

IS_DERIVATIVE = 0.9  # agreement from which a column is the derivative of a position


def add_speeds(survey: Survey, joints: Sequence[LogJoint], commands: Sequence[Channel]) -> None:
    """Give each joint without a speed the column that is the derivative of its position, and has its name.

    Where the log has one joint, any name will do. A goal is none, nor one of two such columns.

    Args:
        survey: Of the log.
        joints: Its joints, which change.
        commands: Of the system; what is called as one of them is no speed.
    """
    known = {column.label for joint in joints for column in joint.columns.values()}
    names = {name for command in commands for name in wanted_names(command.name, "command")}
    free = [c for c in survey.columns if c.usable and c.label not in known and _may_be_speed(c, names)]
    for joint in joints:
        if "speed" in joint.columns:
            continue
        own = set(joint.label.split("_"))
        named = [c for c in free if len(joints) == 1 or own <= set(words_of(c.name))]
        position = survey.samples(joint.columns["position"])
        found = [
            c
            for c in named
            if (relation := relate(*position, *survey.samples(c))) is not None
            and relation.agreement >= IS_DERIVATIVE
            and relation.ratio > 0.0
        ]
        if len(found) == 1:
            joint.columns["speed"] = found[0]


def _may_be_speed(column: ColumnSurvey, commands: Collection[str]) -> bool:
    unit = column.hints.unit
    speed = unit is None or parse_unit(unit).quantity in SPEEDS
    words = set(words_of(column.name))
    return speed and not (GOAL | EFFORT | POSITION) & words and column.name.strip() not in commands

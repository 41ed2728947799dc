"""One joint of a model with the joint of a log that is proposed for it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.logs.inspect.evidence import POSITIONS
from deepkoco.logs.inspect.joints.goals import Tracking
from deepkoco.logs.inspect.joints.log_joints import LogJoint
from deepkoco.logs.inspect.joints.match import Match
from deepkoco.logs.inspect.joints.scaling import Scaling
from deepkoco.logs.inspect.survey import ColumnSurvey
from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel, System


class ProposedJoint(NamedTuple):
    """One joint of the model with its joint in the log."""

    number: int
    match: Match
    log: LogJoint
    scaling: Scaling
    tracking: Tracking | None


def driving_commands(system: System, joint: int) -> list[Channel]:
    """Commands that drive a joint."""
    return [c for c, driven in zip(system.commands, system.command_joints, strict=False) if driven == joint]


def joint_slides(system: System, joint: int) -> bool:
    return system.state_units[joint] == "m"


def joint_range(system: System, joint: int) -> tuple[float, float]:
    """Range of a joint: that of the goals of its servo, or that of its sensor."""
    unit = system.state_units[joint]
    for command, driven in zip(system.commands, system.command_joints, strict=False):
        if driven == joint and command.unit == unit and math.isfinite(command.high - command.low):
            return command.low, command.high
    name = f"q_{system.joint_names[joint]}"
    sensor = next(c for c in system.measurements if c.name == name)
    return sensor.low, sensor.high


def model_positions(joint: ProposedJoint, value: np.ndarray) -> np.ndarray:
    scaling = joint.scaling
    return scaling.factor * value + scaling.factor / scaling.scale * scaling.offset


def speed_goal_column(log: LogJoint) -> ColumnSurvey | None:
    """The commanded speed; a command that does not say what it commands, unless it has the unit of a position."""
    goal = log.columns.get("goal")
    if goal is not None and goal.hints.unit is not None and parse_unit(goal.hints.unit).quantity in POSITIONS:
        goal = None
    return log.columns.get("goal speed") or goal


def effort_column(log: LogJoint, elsewhere: bool = False) -> ColumnSurvey | None:
    """What drives a joint in a unit of its own; a goal only where no effort is ``elsewhere`` in the log."""
    own = log.columns.get("goal effort") or log.columns.get("effort")
    return own or (None if elsewhere else log.columns.get("goal"))

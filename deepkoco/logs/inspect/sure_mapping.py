"""The mapping of logs without a sidecar, where their names leave no doubt.

It is stricter than a proposal, which a user reads before he uses it. Columns are called as joints and actuators are,
and no column is taken by its place; only where a robot has one drive, and the log one effort, this drives it. Units are
in the names of the columns, or the values say them: a goal that its position follows is in the unit of that position,
and a number for an actuator without a unit stays within its limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from deepkoco.logs.formats.log_file import LogError
from deepkoco.logs.formats.open_log import open_log
from deepkoco.logs.inspect.choice import Choice, Proposal, mapping_of
from deepkoco.logs.inspect.evidence import POSITIONS, SPEEDS
from deepkoco.logs.inspect.fitting import Fitting, NoProposalError, propose
from deepkoco.logs.inspect.joints.finding import JointFinding
from deepkoco.logs.inspect.joints.log_joints import EFFORT, POSITION, SPEED, is_symbol_of, words_of
from deepkoco.logs.inspect.joints.match import ITS_WORD, SAME_NAME
from deepkoco.logs.inspect.joints.proposer import ONLY_EFFORT
from deepkoco.logs.inspect.joints.scaling import DERIVED
from deepkoco.logs.inspect.names import WANTED
from deepkoco.logs.inspect.other_quantity import NUMBER_OF, measures_another
from deepkoco.logs.inspect.survey import Survey, survey_log
from deepkoco.logs.part import split_part
from deepkoco.logs.runs import split_run
from deepkoco.logs.sidecar import dump_sidecar
from deepkoco.logs.units import parse_unit
from deepkoco.systems import System

MOST_LOGS = 40  # of those with the same columns that are compared
ONE_UNIT = (0.7, 1.4)  # slope of a position against its goal, from which both are in one unit
# Times the limits of an actuator, within which its commands are in its unit; and those that only its load lets guess.
WITHIN, ABOUT = 1.2, 10.0
FAINT = 0.02  # share of those limits that a converted command exceeds


class SureMappings:
    """Mappings of the logs of one call, one for each set of columns.

    Args:
        logs: All logs without a sidecar.
        system: The system.
    """

    def __init__(self, logs: Sequence[Path], system: System) -> None:
        self._logs, self._system = [_whole(log) for log in logs], system
        self._surveys: dict[tuple[Path, int], Survey] = {}
        self._found: dict[tuple[str, ...], tuple[dict[str, Any], str] | LogError] = {}

    def of(self, log: Path) -> tuple[dict[str, Any], str]:
        """Content of a sidecar, and a sentence that says what was taken and assumed.

        Args:
            log: The log; a part of it counts as the whole.

        Raises:
            LogError: The mapping is not sure; the message says why.
        """
        own = self._survey(*_whole(log))
        columns = tuple(c.label for c in own.columns)
        if columns not in self._found:
            try:
                self._found[columns] = self._mapping(own, columns)
            except LogError as error:
                self._found[columns] = error
        found = self._found[columns]
        if isinstance(found, LogError):
            raise found
        return found

    def _survey(self, path: Path, run: int) -> Survey:
        if (path, run) not in self._surveys:
            self._surveys[path, run] = survey_log(open_log(path), run)
        return self._surveys[path, run]

    def _mapping(self, own: Survey, columns: tuple[str, ...]) -> tuple[dict[str, Any], str]:
        others = []
        for path, run in dict.fromkeys(self._logs[:MOST_LOGS]):
            try:
                other = self._survey(path, run)
            except (LogError, ValueError):
                continue  # its own reading says what is wrong with it
            if other is not own and tuple(c.label for c in other.columns) == columns:
                others.append(other)
        try:
            fitting = propose(own, self._system, others)
        except NoProposalError as error:
            raise LogError(str(error)) from error
        doubt = doubt_of_mapping(own, fitting, self._system)
        if doubt is not None:
            raise LogError(doubt)
        text = dump_sidecar(None, mapping_of(own, fitting.proposal), {"proposed by": "deepkoco inspect"})
        return yaml.safe_load(text), _said(fitting.proposal)


def _whole(log: Path) -> tuple[Path, int]:
    whole, run = split_run(split_part(log)[0])
    return whole, run or 0


def doubt_of_mapping(survey: Survey, fitting: Fitting, system: System) -> str | None:
    """Why a proposal for a log is not sure; None where it is."""
    joints = {finding.model: finding for finding in fitting.proposal.joints}
    if not joints:
        return _doubt_of_names(fitting)
    others = _may_drive(survey, fitting.proposal.unused(survey))
    for choice in fitting.proposal.choices:
        name, column = choice.channel.name, choice.column
        if column is None:
            if choice.channel.kind == "command" and choice.channel.default is None:
                return f"no column is the command {name} for sure"
            continue
        by_name = choice.sureness == "sure" and any(map(_names_it, choice.reasons))
        if not (by_name or (choice.held and choice.channel.kind == "command")):
            return f"{name} is {choice.sureness}, but not by its name: {column.label}"
        if measures_another(choice):
            return f"{column.label} is in {choice.unit}, and {name} is in {choice.channel.unit}"
        known = choice.stated or choice.held or DERIVED in choice.reasons
        if choice.channel.kind == "measurement" and not known:
            return f"no name says that {column.label} is in {choice.unit}"
        if choice.channel.kind == "command" and (doubt := _doubt_of_command(choice, joints, system, others)):
            return doubt
    return fitting.doubt


def _may_drive(survey: Survey, labels: Sequence[str]) -> list[str]:
    """Those of some columns that may be what drives a joint: their units are not those of a motion."""
    units = {c.label: c.hints.unit for c in survey.columns}
    return [label for label in labels if (unit := units[label]) is None or not _of_motion(unit)]


def _of_motion(unit: str) -> bool:
    return parse_unit(unit).quantity in {*POSITIONS, *SPEEDS}


def _names_it(reason: str) -> bool:
    return reason in (SAME_NAME, ONLY_EFFORT) or ITS_WORD in reason


def _doubt_of_names(fitting: Fitting) -> str | None:
    """Why a proposal for a system whose joints have no names is not sure; None where it is."""
    for choice in fitting.proposal.choices:
        name, column = choice.channel.name, choice.column
        if column is None:
            if choice.channel.kind == "command" and choice.channel.default is None:
                return f"no column is the command {name} for sure"
            continue
        if choice.sureness != "sure":
            return f"{column.label} is only {choice.sureness} for {name}"
        if choice.rival is not None:
            return f"{name} may be {column.label} or {choice.rival}"
        if measures_another(choice):
            return f"{column.label} is in {choice.unit}, and {name} is in {choice.channel.unit}"
        if not choice.stated:
            return f"no name says that {column.label} is in {choice.unit}"
    return fitting.doubt


def _doubt_of_command(
    choice: Choice, joints: dict[str, JointFinding], system: System, others: Sequence[str]
) -> str | None:
    """Why a column is not a command for sure; None where it is.

    Args:
        choice: The column.
        joints: What was found of each joint.
        system: The system.
        others: Labels of the columns that are no channel.
    """
    column, channel = choice.column, choice.channel
    assert column is not None
    number = [c.name for c in system.commands].index(channel.name)
    driven = system.command_joints[number] if number < len(system.command_joints) else None
    named = "" if driven is None else system.joint_names[driven]
    said = set(words_of(column.name)) - set(words_of(named))  # a joint may be called phi
    if others and _may_be_measured(choice):
        # What drives the joint may be in one of them.
        return f"{column.label} is measured, and may not be the command {channel.name}, beside {', '.join(others)}"
    if driven is not None and channel.unit == system.state_units[driven]:
        if column.hints.unit is not None and column.hints.unit == choice.unit:
            return None
        finding = joints.get(system.joint_names[driven])
        tracking = None if finding is None else finding.tracking
        follows = tracking is not None and tracking.follows and ONE_UNIT[0] < tracking.slope < ONE_UNIT[1]
        return None if follows else f"{column.label} is no goal that its position follows in one unit"
    # A drive that takes the goal of a speed; whether the column is in its unit is asked below.
    of_a_speed = driven is not None and channel.unit == system.state_units[system.joints + driven]
    other = POSITION if of_a_speed else POSITION | SPEED
    if not is_symbol_of(column) and (
        said & other or (said & set(WANTED) and not (of_a_speed or said & EFFORT))
    ):
        return f"{column.label} may be a goal of a position or a speed, and {channel.name} is none"
    if choice.stated or choice.held:
        return None
    most = max(abs(channel.low), abs(channel.high))
    largest = abs(choice.scale) * max(abs(column.low or 0.0), abs(column.high or 0.0))
    beyond = largest > (ABOUT if channel.guessed else WITHIN) * most
    # The limits of a model may count thousandths, too.
    tiny = choice.scale != 1.0 and not channel.guessed and largest < FAINT * most
    if channel.unit != "1" or said & EFFORT or beyond or tiny:
        return f"no name says that {column.label} is in {choice.unit}"
    return None


def _said(proposal: Proposal) -> str:
    taken = ", ".join(
        f"{c.channel.name} = {c.column.label} [{c.unit}]" for c in proposal.choices if c.column is not None
    )
    unknown = {
        what: [joint.model for joint in proposal.joints if not getattr(joint, f"{what}_known")]
        for what in ("sign", "zero")
    }
    words = {"sign": "direction", "zero": "zero"}
    assumed = [f"the {words[k]} of {', '.join(v)} is the model's" for k, v in unknown.items() if v]
    assumed += [
        _assumed_of(c, c.column.label) for c in proposal.choices if c.column is not None and not c.stated
    ]
    assumed += [
        f"{c.column.label} is what drives {c.channel.name}, commanded or measured"
        for c in proposal.choices
        if c.column is not None and _may_be_measured(c)
    ]
    return (
        f"no sidecar: {taken}"
        + (f"; assumed: {'; '.join(assumed)}" if assumed else "")
        + "; to correct it, write it with deepkoco inspect --out"
    )


def _may_be_measured(choice: Choice) -> bool:
    """Whether a column of a command has a name as measured efforts have."""
    return any("in the place of" in reason for reason in choice.reasons)


def _assumed_of(choice: Choice, label: str) -> str:
    size = abs(choice.scale)
    if f"{NUMBER_OF} N m" in choice.reasons and size == 1.0:
        return f"{label} is {choice.channel.name} before its gear"
    if choice.channel.unit == "1" and size != 1.0:
        return f"{label} times {size:.3g} is {choice.channel.name}"
    return f"{label} is in {choice.unit}" + (", as the equations ask" if choice.held else "")

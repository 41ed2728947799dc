"""Propose the mapping of a log of many joints: columns, units, signs and zeros of each."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from deepkoco.logs.inspect.choice import Choice, Proposal, with_one_scale
from deepkoco.logs.inspect.evidence import POSITIONS, SPEEDS
from deepkoco.logs.inspect.joints.by_own_name import (
    NAMED,
    called_as_actuators,
    command_by_name,
    give_commands,
    speed_by_name,
)
from deepkoco.logs.inspect.joints.finding import JointFinding, from_ranges
from deepkoco.logs.inspect.joints.goals import Tracking, track
from deepkoco.logs.inspect.joints.gravity import JointEvidence
from deepkoco.logs.inspect.joints.log_joints import (
    LogJoint,
    log_joints,
    loose_efforts,
    loose_goals,
    role_in_name,
    role_of,
)
from deepkoco.logs.inspect.joints.match import Match, match_joints
from deepkoco.logs.inspect.joints.proposed_joint import (
    ProposedJoint,
    driving_commands,
    effort_column,
    joint_range,
    joint_slides,
    model_positions,
    speed_goal_column,
)
from deepkoco.logs.inspect.joints.scaling import Scaling, alike, position_scaling, speed_scaling
from deepkoco.logs.inspect.joints.slow_samples import gravity_evidence
from deepkoco.logs.inspect.joints.speed_by_values import add_speeds
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel, System

GOAL_ZERO = 0.2  # difference of goal and position above which their zeros differ [rad or m]
ONLY_EFFORT = "the only effort, in the place of the only command"  # reason that a column drives a joint
LOOSE = 0.5  # probability that an effort without the name of a joint drives the next joint in the order
LEAST = 3.0  # evidence of a proposal for each joint [nats], compared with other systems


def has_named_joints(system: System) -> bool:
    """Whether a system names its measurements after its joints: `q_shoulder`, `dq_shoulder`."""
    names = {channel.name for channel in system.measurements}
    return all(f"q_{joint}" in names for joint in system.joint_names)


def propose_joints(surveys: Sequence[Survey], system: System) -> Proposal:
    """Propose which columns belong to which joint, with unit, direction and zero.

    Args:
        surveys: logs with the same columns; the mapping is that of the first, and all serve as evidence.
        system: a system whose measurements are named after its joints.
    """
    survey = surveys[0]
    passive = system.joints - len(set(system.actuator_joints) & set(range(system.joints)))
    found = log_joints(survey.columns, system.joint_names, system.state_units[: system.joints], passive)
    called = called_as_actuators(survey, system)
    others = [column for column in survey.columns if column not in called.values()]
    apart = log_joints(others, system.joint_names, system.state_units[: system.joints], passive)
    # What is called as an actuator may still be the position of its joint: then the log has no other.
    found, called = (apart, called) if len(apart) >= len(found) else (found, {})
    matches = match_joints([joint.label for joint in found], system.joint_names, _apart(found, system))
    give_commands(called, {match.model: found[match.log] for match in matches}, system)
    _add_loose_goals(survey, found, system)
    add_speeds(survey, found, system.commands)
    joints = _scaled(surveys, system, found, matches)
    evidence = gravity_evidence(surveys, system, joints)
    findings = {joint.number: _finding(survey, system, joint, evidence) for joint in joints}
    by_number = {joint.number: joint for joint in joints}
    measured = with_one_scale(
        [_measurement(survey, system, c, by_number, findings) for c in system.measurements]
    )
    measured = [speed_by_name(survey, choice, set(by_number), system) for choice in measured]
    efforts = bool(loose_efforts(survey.columns, found))
    commanded = [
        _command(survey, system, k, by_number, findings, efforts) for k in range(len(system.commands))
    ]
    shown = {c.column.label for c in measured if c.column is not None}
    commanded = [
        command_by_name(survey, choice, shown, _driven_alone(system, k), efforts)
        for k, choice in enumerate(commanded)
    ]
    taken = {c.column.label for c in commanded if c.column is not None}
    loose = [column for column in loose_efforts(survey.columns, found) if column.label not in taken]
    choices = [*measured, *_with_loose_efforts(system, commanded, loose)]
    clocks = [survey.clock(c.column) for c in choices if c.column is not None]
    time = next((clock.unit for clock in clocks if clock is not None), "s")
    score = LEAST * sum(joint.match.probability for joint in joints)
    return Proposal(
        system.name, tuple(choices), time, score, {}, tuple(findings[k] for k in sorted(findings))
    )


def _driven_alone(system: System, number: int) -> str:
    """Name of the joint that this command drives and no other one does; empty if there is none."""
    driven = system.command_joints
    alone = number < len(driven) and driven.count(driven[number]) == 1
    return system.joint_names[driven[number]] if alone else ""


def _apart(found: Sequence[LogJoint], system: System) -> list[tuple[int, int]]:
    """Pairs of a joint of the log, whose unit is stated, and one of the model, of which one slides and one turns."""
    stated = {i: joint.columns["position"].hints.unit for i, joint in enumerate(found)}
    quantities = [parse_unit(unit).quantity for unit in system.state_units[: system.joints]]
    return [
        (i, j)
        for i, unit in stated.items()
        if unit is not None and parse_unit(unit).quantity in POSITIONS
        for j, quantity in enumerate(quantities)
        if parse_unit(unit).quantity != quantity
    ]


def _add_loose_goals(survey: Survey, joints: list[LogJoint], system: System) -> None:
    """Give goals without names of joints, such as `data[0]`, to the joints that follow them.

    What is called as an actuator that takes no position is no goal of one.
    """
    actuators = {
        role_in_name(channel.name)[1]
        for channel, joint in zip(system.commands, system.command_joints, strict=False)
        if channel.unit != system.state_units[joint]
    }
    loose = [goal for goal in loose_goals(survey.columns, joints) if role_of(goal)[1] not in actuators]
    free = [joint for joint in joints if "goal" not in joint.columns]
    for goal in loose:
        relations = {joint.label: _track(survey, joint.columns["position"], goal) for joint in free}
        good = {label: r.explained for label, r in relations.items() if r is not None and r.follows}
        if good:
            label = max(good, key=lambda name: good[name])
            chosen = next(joint for joint in free if joint.label == label)
            chosen.columns["goal"] = goal
            free.remove(chosen)


def _track(survey: Survey, position: ColumnSurvey, goal: ColumnSurvey) -> Tracking | None:
    (t, value), (t_goal, wanted) = survey.samples(position), survey.samples(goal)
    if len(t) < 2 or len(t_goal) < 1:
        return None
    return track(t, value, t_goal, wanted)


def _best_track(surveys: Sequence[Survey], position: ColumnSurvey, goal: ColumnSurvey) -> Tracking | None:
    """Relation of position and goal in the log in which the goal changes most."""
    found: list[tuple[float, Tracking]] = []
    for survey in surveys:
        there = {column.label: column for column in survey.columns if column.usable}
        if position.label in there and goal.label in there:
            relation = _track(survey, there[position.label], there[goal.label])
            if relation is not None:
                found.append((float(np.ptp(survey.samples(there[goal.label])[1])), relation))
    return max(found, key=lambda entry: entry[0])[1] if found else None


def _scaled(
    surveys: Sequence[Survey], system: System, found: Sequence[LogJoint], matches: Sequence[Match]
) -> list[ProposedJoint]:
    scalings, survey = [], surveys[0]
    for match in matches:
        column = found[match.log].columns["position"]
        low, high = joint_range(system, match.model)
        scalings.append(
            position_scaling(column, survey.samples(column)[1], low, high, joint_slides(system, match.model))
        )
    scalings = alike(scalings, [not joint_slides(system, match.model) for match in matches])
    result = []
    for match, scaling in zip(matches, scalings, strict=True):
        log = found[match.log]
        goal = log.columns.get("goal")
        if any(c.unit != system.state_units[match.model] for c in driving_commands(system, match.model)):
            goal = None  # a force or a speed, which a position does not follow
        tracking = None if goal is None else _best_track(surveys, log.columns["position"], goal)
        result.append(ProposedJoint(match.model, match, log, scaling, tracking))
    return result


def _finding(
    survey: Survey, system: System, joint: ProposedJoint, evidence: list[JointEvidence] | None
) -> JointFinding:
    pull = None if evidence is None else evidence[joint.number]
    low, high = joint_range(system, joint.number)
    value = model_positions(joint, survey.samples(joint.log.columns["position"])[1])
    by_range = from_ranges(
        low, high, float(value.min()), float(value.max()), not joint_slides(system, joint.number)
    )
    sign, zero, sign_known, zero_known = 1, 0.0, False, False
    why_sign = "assumed: gravity does not show it in this log"
    why_zero = "assumed: this log does not show it"
    if pull is not None and pull.sign_known:
        sign, sign_known = pull.sign, True
        why_sign = f"gravity fits this direction better by {pull.margin:.0f} nats"
        zero = pull.zero
        zero_known = pull.zero_known
        within = "" if math.isinf(pull.width) else f" within {pull.width:.1g} rad"
        if zero:
            why_zero = f"gravity fits this zero better by {pull.gain:.0f} nats{within}"
        elif zero_known:
            why_zero = f"gravity agrees with the model's zero{within}"
        else:
            why_zero = f"assumed: zeros{within or ' far'} from the model's fit gravity about as well"
    elif by_range is not None:
        sign, zero, why = by_range
        sign_known = sign < 0
        why_sign = why if sign < 0 else why_sign
        why_zero = f"assumed: {why}" if zero else why_zero
    notes = [joint.scaling.note] if joint.scaling.note else []
    return JointFinding(
        system.joint_names[joint.number],
        joint.log.label or joint.log.columns["position"].name,
        joint.match.probability,
        joint.match.reason,
        joint.scaling.unit,
        joint.scaling.factor,
        sign,
        zero,
        sign_known,
        zero_known,
        why_sign,
        why_zero,
        _in_si(joint),
        pull,
        tuple(notes),
    )


def _in_si(joint: ProposedJoint) -> Tracking | None:
    tracking = joint.tracking
    if tracking is None:
        return None
    zero = joint.scaling.factor / joint.scaling.scale * joint.scaling.offset
    return tracking._replace(
        offset=joint.scaling.factor * tracking.offset + zero * (1.0 - abs(tracking.slope))
    )


def _measurement(
    survey: Survey,
    system: System,
    channel: Channel,
    joints: dict[int, ProposedJoint],
    findings: dict[int, JointFinding],
) -> Choice:
    number = next(
        (j for j, name in enumerate(system.joint_names) if channel.name in (f"q_{name}", f"dq_{name}")), None
    )
    joint = None if number is None else joints.get(number)
    if number is None or joint is None:
        return Choice(channel, None, channel.unit, False, 1.0, ())
    finding, scaling = findings[number], joint.scaling
    if channel.name.startswith("q_"):
        column = joint.log.columns["position"]
        scale, offset = _frame(finding, scaling, 1.0)
        return _chosen(channel, column, scaling, finding, (finding.reason,), scale, offset)
    column = joint.log.columns.get("speed")
    if column is None:
        return Choice(channel, None, channel.unit, False, 1.0, ())
    t, value = survey.samples(joint.log.columns["position"])
    speed = speed_scaling(
        (t, model_positions(joint, value)), column, survey.samples(column), joint_slides(system, number)
    )
    if speed is None:
        why = (f'"{column.name}" is left out: it is not the derivative of the position',)
        return Choice(channel, None, channel.unit, False, 1.0, why)
    reasons = (finding.reason, speed.note) if speed.note else (finding.reason,)
    return _chosen(channel, column, speed, finding, reasons, finding.sign * speed.scale, 0.0)


def _command(
    survey: Survey,
    system: System,
    number: int,
    joints: dict[int, ProposedJoint],
    findings: dict[int, JointFinding],
    efforts: bool,
) -> Choice:
    channel = system.commands[number]
    driven = system.command_joints[number] if number < len(system.command_joints) else None
    joint = None if driven is None else joints.get(driven)
    if driven is None or joint is None:
        return Choice(channel, None, channel.unit, False, 1.0, ())
    finding, tracking = findings[driven], joint.tracking
    if channel.unit != system.state_units[driven]:
        speed = parse_unit(channel.unit).quantity in SPEEDS
        column = speed_goal_column(joint.log) if speed else effort_column(joint.log, efforts)
        if column is None:
            return Choice(channel, None, channel.unit, False, 1.0, ())
        said = [finding.reason]
        # `axis1_motor_Nm` is what drives the axis; words such as torque or current may say what was measured there.
        if not speed and "goal effort" not in joint.log.columns and role_of(column)[0] == "effort":
            said.append("a measured effort in the place of the command")
        scaling = Scaling(column.hints.unit or channel.unit, 1.0, 0.0, column.hints.unit is not None)
        return _chosen(channel, column, scaling, finding, said, float(finding.sign), 0.0)
    column = joint.log.columns.get("goal")
    if column is None:
        return Choice(channel, None, channel.unit, False, 1.0, ())
    reasons, scaling, direction, shift = [finding.reason], joint.scaling, 1.0, 0.0
    if tracking is not None and tracking.follows:
        direction = -1.0 if tracking.slope < 0 else 1.0
        reasons.append(
            f"the position follows it after {tracking.delay:.2f} s with the slope {tracking.slope:.2f}"
        )
        moved = _in_si(joint)
        assert moved is not None
        if 0.7 < abs(tracking.slope) < 1.4 and abs(moved.offset) > GOAL_ZERO:
            shift = moved.offset
            reasons.append(f"its zero differs from that of the position by {shift:.3g}")
    scale, offset = _frame(finding, scaling, direction)
    offset += finding.sign * shift / (scaling.factor / scaling.scale)
    return _chosen(channel, column, scaling, finding, reasons, scale, offset)


def _with_loose_efforts(
    system: System, commands: Sequence[Choice], loose: Sequence[ColumnSurvey]
) -> list[Choice]:
    """Give efforts without names of joints, in their order, to the commands of forces that have no column.

    A column with a unit goes to a command whose unit measures the same: a sensor of forces in N drives no joint that
    takes N m. Where a unit has more columns than commands, none of them is taken.
    """
    free = [
        k
        for k, choice in enumerate(commands)
        if choice.column is None
        and k < len(system.command_joints)
        and choice.channel.unit != system.state_units[system.command_joints[k]]
        and parse_unit(choice.channel.unit).quantity not in SPEEDS
    ]
    result = list(commands)
    quantities = [None if c.hints.unit is None else parse_unit(c.hints.unit).quantity for c in loose]
    there = Counter(quantities)
    takers = {q: [k for k in free if _takes(commands[k].channel, q)] for q in there}
    kept = [
        (column, quantity)
        for column, quantity in zip(loose, quantities, strict=True)
        if quantity is None or there[quantity] <= len(takers[quantity])
    ]
    if len(kept) > len(free):
        return result
    for column, quantity in kept:
        unit = column.hints.unit
        fitting = [k for k in takers[quantity] if k in free]
        if not fitting:  # columns without a unit have taken the commands
            continue
        k = fitting[0]
        free.remove(k)
        channel = commands[k].channel
        alone = len(commands) == len(kept) == 1 and quantity == parse_unit(channel.unit).quantity
        score, reason = (NAMED, ONLY_EFFORT) if alone else (LOOSE, "the next effort in the order")
        result[k] = Choice(channel, column, unit or channel.unit, unit is not None, score, (reason,))
    return result


def _takes(command: Channel, quantity: str | None) -> bool:
    """Whether a command may be an effort of this quantity, None for one without a unit; a number may be any."""
    own = parse_unit(command.unit).quantity
    return quantity is None or own == quantity or own == "ratio"


def _frame(finding: JointFinding, scaling: Scaling, direction: float) -> tuple[float, float]:
    """Scale and offset, in the unit of the column, that lead to the frame of the model."""
    unit = scaling.factor / scaling.scale
    return finding.sign * direction * scaling.scale, finding.sign * scaling.offset + finding.zero / unit


def _chosen(
    channel: Channel,
    column: ColumnSurvey,
    scaling: Scaling,
    finding: JointFinding,
    reasons: Sequence[str],
    scale: float,
    offset: float,
) -> Choice:
    return Choice(
        channel,
        column,
        scaling.unit,
        scaling.stated,
        finding.probability,
        tuple(reasons),
        scale=scale,
        offset=offset,
    )

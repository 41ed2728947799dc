"""Find out whether a system can have made a log at all, for a proposal is only the best of what there is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from deepkoco.logs.checks.derivative import slip
from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.evidence import POSITIONS, SPEEDS, STRIDE, Samples
from deepkoco.logs.inspect.joints.goals import track
from deepkoco.logs.inspect.other_quantity import measures_another
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import factor_between, parse_unit
from deepkoco.systems import Motion, ParameterError, System

MEANS = 2.0  # evidence from which a name means a position or a speed [nats]
DERIVED = 0.9  # agreement from which a column is certainly the derivative of another
COPY = 0.98  # correlation above which a column repeats another one
GRAVITY = (
    0.1,
    30.0,
)  # acceleration by gravity in the log relative to the system, whose parameters may be wrong
DRIVE = (1e-3, 1e3)  # the same of the commands
SURE = 5.0  # standard deviations by which a factor must lie outside
EXPLAINED = 0.5  # share of the changes of speed that the regression explains at least
ONE_TURN = 2.02 * np.pi  # range up to which a goal may begin again after a turn [rad]
FOLLOWED = 0.2  # share of the variance of a position that the goal of a servo explains at least


def misfit(system: System, proposal: Proposal, survey: Survey, samples: Mapping[str, Samples]) -> str | None:
    """Reason why a system cannot have made a log; None if there is none.

    Args:
        system: the system.
        proposal: its proposed mapping.
        survey: survey of the log.
        samples: label -> stamps and values of the columns.
    """
    lacking = [c.channel.name for c in proposal.choices if c.column is None and _is_needed(c)]
    if lacking:
        found = [c.channel.name for c in proposal.choices if c.column is not None]
        return f"the log has no column for {', '.join(lacking)}{system.way_to_hold(found)}"
    left = _left_over(proposal, survey, samples)
    if left and not _follows(system, proposal):
        return f"it has no joint for {', '.join(left[:4])}"
    # Small errors of a goal's stamps are large accelerations, so that the law of a servo is not compared.
    law = _lost_goal if _has_servo(system) else _wrong_law
    return law(system, proposal, samples)


def _follows(system: System, proposal: Proposal) -> bool:
    """Whether each joint follows its goal: what else moves is then a pose of the tip, or of an object beside it."""
    relations = [joint.tracking for joint in proposal.joints]
    return len(relations) == system.joints and all(r is not None and r.follows for r in relations)


def _is_needed(choice: Choice) -> bool:
    """A log may lack speeds, and commands with a default."""
    if choice.channel.kind == "command":
        return choice.channel.default is None
    return parse_unit(choice.channel.unit).quantity in POSITIONS


def _left_over(proposal: Proposal, survey: Survey, samples: Mapping[str, Samples]) -> list[str]:
    """Measured positions and speeds of the log that the proposal does not use."""
    taken = {c.column.label for c in proposal.choices if c.column is not None}
    free = [c for c in survey.columns if c.kind == "number" and c.label in samples and c.label not in taken]
    moving = {
        label
        for pair, relation in proposal.relations.items()
        if relation.agreement > DERIVED and (0.8 < relation.ratio < 1.25 or slip(relation.ratio) is not None)
        for label in pair
        if not taken & set(pair)
    }
    return [
        f'"{column.name}"'
        for column in free
        if not column.hints.commanded
        and not column.hints.wanted
        and (column.label in moving or _means_motion(column))
        and not any(_repeats(samples[column.label], samples[other]) for other in taken if other in samples)
    ]


def _means_motion(column: ColumnSurvey) -> bool:
    if column.hints.unit is not None:
        return parse_unit(column.hints.unit).quantity in (*POSITIONS, *SPEEDS)
    return max(column.hints.speaks_for(quantity) for quantity in (*POSITIONS, *SPEEDS)) >= MEANS


def _repeats(a: Samples, b: Samples) -> bool:
    (t, value), (t_other, other) = a, b
    if len(t) < 10 or len(t_other) < 10:
        return False
    resampled = np.interp(t, t_other, other)
    if np.std(resampled) == 0 or np.std(value) == 0:
        return False
    return abs(float(np.corrcoef(value, resampled)[0, 1])) > COPY


def _wrong_law(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> str | None:
    """Say that gravity or a command surely does not act on a joint as in the system, whatever its parameters are.

    Changes of the speed over 0.2 s are regressed on the integrals of the system's acceleration at rest, of what the
    commands add to it, of the speed, and of its smoothed sign; and of a constant, unless gravity is one. Joints that
    move each other are not compared, for the regressors of a controlled motion are nearly the same there.
    """
    if system.joints > 1:
        return None
    motion = _motion(system, proposal, samples)
    if motion is None:
        return None
    t, angles, speeds, efforts = motion
    stride = int(max(2, round(STRIDE / float(np.median(np.diff(t))))))
    if len(t) < 8 * stride:
        return None
    law = _accelerations(system, angles, efforts)
    if law is None:
        return None
    (rest, driven), speed = law[0], speeds[0]
    terms = [rest, driven, speed, np.tanh(speed / max(0.05 * float(np.std(speed)), 1e-9))]
    terms += [np.ones(len(t))] if np.std(rest) > 1e-6 * float(np.abs(rest).max(initial=0.0)) else []
    matrix = np.stack([_integral(term, t, stride)[::stride] for term in terms], axis=1)
    target = (speed[stride:] - speed[:-stride])[::stride]
    weights, sd, explained = _regress(matrix, target)
    if explained < EXPLAINED:
        return None
    for k, (what, (low, high)) in enumerate((("gravity", GRAVITY), ("the command", DRIVE))):
        outside = weights[k] + SURE * sd[k] < low or weights[k] - SURE * sd[k] > high
        if outside and np.abs((rest, driven)[k]).max() > 0:
            turned = what == "gravity" and weights[k] < -GRAVITY[0] and system.state_units[0] == "rad"
            hint = " (its zero may be half a turn off: offset)" if turned else ""
            return f"{what} accelerates the joint {weights[k]:.2g} times as much as in the system{hint}"
    return None


def _accelerations(
    system: System, angles: list[np.ndarray], efforts: list[np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """For each joint, its acceleration at rest without commands, and what the commands add."""
    values = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in system.parameters}
    still = tuple(torch.zeros(len(angles[0]), dtype=torch.float64) for _ in angles)
    place = tuple(map(torch.from_numpy, angles))
    none = tuple(torch.zeros(len(angles[0]), dtype=torch.float64) for _ in efforts)
    try:
        law = system.accelerations(values)
        rest = law(Motion(place, still, none))
        driven = law(Motion(place, still, tuple(map(torch.from_numpy, efforts))))
    except (ParameterError, NotImplementedError, RuntimeError, KeyError):
        return None
    shape = angles[0].shape
    return [
        (np.broadcast_to(a.numpy(), shape), np.broadcast_to((b - a).numpy(), shape))
        for a, b in zip(rest, driven, strict=True)
    ]


def _lost_goal(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> str | None:
    """Say that a position does not follow the goal of its servo.

    The findings of named joints show it for each of them, and from all logs.
    """
    if proposal.joints:
        return None
    chosen = {c.channel.name: c for c in proposal.choices if c.column is not None}
    for command, joint in zip(system.commands, system.command_joints, strict=False):
        state = next(
            (m for m, k in zip(system.measurements, system.measured_states, strict=True) if k == joint), None
        )
        if command.unit != system.state_units[joint] or state is None:
            continue
        goal, position = chosen.get(command.name), chosen.get(state.name)
        if goal is None or position is None or goal.column is None or position.column is None:
            continue
        (t, place), (sent, wanted) = samples[position.column.label], samples[goal.column.label]
        if position.scale != 1.0 and command.unit == "rad":
            # Ticks of a turn, which may begin again after each.
            place, wanted = np.unwrap(position.scale * place), goal.scale * wanted
            wanted = np.unwrap(wanted) if np.ptp(wanted) <= ONE_TURN else wanted
        relation = track(t, place, sent, wanted)
        if relation is not None and relation.explained < FOLLOWED:
            return f'"{position.column.name}" does not follow "{goal.column.name}" as behind a servo'
    return None


def _has_servo(system: System) -> bool:
    kinds = zip(system.commands, system.command_joints, strict=False)
    return any(command.unit == system.state_units[joint] for command, joint in kinds)


def _motion(
    system: System, proposal: Proposal, samples: Mapping[str, Samples]
) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray], list[np.ndarray]] | None:
    """Common times, and positions, speeds and commands there [SI]."""
    read: dict[str, Samples] = {}
    for choice in proposal.choices:
        if choice.column is not None and choice.column.label in samples and not measures_another(choice):
            t, value = samples[choice.column.label]
            factor = factor_between(choice.unit, choice.channel.unit)
            read[choice.channel.name] = t, factor * (choice.scale * value + choice.offset)
    states: dict[int, Samples] = {}
    for channel, state in zip(system.measurements, system.measured_states, strict=True):
        if channel.name in read:
            states[state] = read[channel.name]
    if any(joint not in states for joint in range(system.joints)):
        return None
    t = states[0][0]
    if len(t) < 40:
        return None
    angles, speeds = [], []
    for joint in range(system.joints):
        turns = system.state_units[joint] == "rad"
        angle = np.interp(t, states[joint][0], np.unwrap(states[joint][1]) if turns else states[joint][1])
        angles.append(angle)
        rate = states.get(system.joints + joint)
        speeds.append(np.gradient(angle, t) if rate is None else np.interp(t, *rate))
    efforts = []
    for command in system.commands:
        if command.name in read:
            at, value = read[command.name]
            efforts.append(value[np.maximum(np.searchsorted(at, t, side="right") - 1, 0)])
        else:
            efforts.append(np.full(len(t), 0.0 if command.default is None else command.default))
    return t, angles, speeds, efforts


def _integral(value: np.ndarray, t: np.ndarray, stride: int) -> np.ndarray:
    total = np.append(0.0, np.cumsum(value[:-1] * np.diff(t)))
    return total[stride:] - total[:-stride]


def _regress(matrix: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Weights of a least-squares fit, their standard deviations, and the explained share of the target."""
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    scaled = matrix / scale
    weights, *_ = np.linalg.lstsq(scaled, target, rcond=1e-10)
    squares = float(np.sum((target - scaled @ weights) ** 2))
    left = squares / max(len(target) - matrix.shape[1], 1)
    covariance = np.linalg.pinv(scaled.T @ scaled)
    sd = np.sqrt(np.maximum(left * np.diag(covariance), 0.0)) / scale
    return weights / scale, sd, 1.0 - squares / max(float(np.sum(target**2)), 1e-300)

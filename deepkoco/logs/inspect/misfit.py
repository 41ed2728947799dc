"""Find out whether a system can have made a log at all, for a proposal is only the best of what there is."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch

from deepkoco.logs.checks.derivative import slip
from deepkoco.logs.inspect.evidence import POSITIONS, SPEEDS, STRIDE, Samples
from deepkoco.logs.inspect.proposal import Choice, Proposal
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import factor_between, parse_unit
from deepkoco.systems import Motion, ParameterError, System

MEANS = 2.0  # evidence from which a name means a position or a speed [nats]
DERIVED = 0.9  # agreement from which a column is certainly the derivative of another
COPY = 0.98  # correlation above which a column repeats another one
SLOPE = (0.1, 10.0)  # of the measured accelerations on those of the system, whose parameters may be wrong
SURE = 8.0  # standard deviations by which the slope must lie outside


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
        return f"the log has no column for {', '.join(lacking)}"
    left = _left_over(proposal, survey, samples)
    if left:
        return f"it has no joint for {', '.join(left[:4])}"
    slope = _slope(system, proposal, samples)
    if slope is not None:
        return f"its accelerations are not those of the log: they fit with the factor {slope:.2g} and not with about 1"
    return None


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


def _slope(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> float | None:
    """Factor between the system's accelerations and those of the log, if it is surely wrong for one of the joints.

    Changes of the speed over 0.2 s are regressed on the integral of the system's acceleration at nominal parameters,
    and on friction: integrals of the speed, of its smoothed sign, and of a constant.
    """
    if _has_servo(system):
        return None  # small errors of the goal's stamps are large accelerations
    motion = _motion(system, proposal, samples)
    if motion is None:
        return None
    t, angles, speeds, efforts = motion
    values = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in system.parameters}
    try:
        given = Motion(*(tuple(map(torch.from_numpy, part)) for part in (angles, speeds, efforts)))
        found = system.accelerations(values)(given)
    except (ParameterError, NotImplementedError, RuntimeError, KeyError):
        return None
    stride = int(max(2, round(STRIDE / float(np.median(np.diff(t))))))
    if len(t) < 8 * stride:
        return None
    slopes = []
    for speed, acceleration in zip(speeds, found, strict=True):
        law = np.broadcast_to(acceleration.numpy(), speed.shape)
        terms = [law, speed, np.tanh(speed / max(0.05 * float(np.std(speed)), 1e-9)), np.ones(len(t))]
        matrix = np.stack([_integral(term, t, stride)[::stride] for term in terms], axis=1)
        target = (speed[stride:] - speed[:-stride])[::stride]
        slope, sd = _first_weight(matrix, target)
        outside = slope + SURE * sd < SLOPE[0] or slope - SURE * sd > SLOPE[1]
        slopes += [slope] if outside else []
    return slopes[0] if slopes else None


def _has_servo(system: System) -> bool:
    kinds = zip(system.commands, system.command_joints, strict=False)
    return any(command.unit == system.state_units[joint] for command, joint in kinds)


def _motion(
    system: System, proposal: Proposal, samples: Mapping[str, Samples]
) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray], list[np.ndarray]] | None:
    """Common times, and positions, speeds and commands there [SI]."""
    read: dict[str, Samples] = {}
    for choice in proposal.choices:
        if choice.column is not None and choice.column.label in samples:
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


def _first_weight(matrix: np.ndarray, target: np.ndarray) -> tuple[float, float]:
    """First weight of a least-squares fit, and its standard deviation."""
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    scaled = matrix / scale
    weights, *_ = np.linalg.lstsq(scaled, target, rcond=1e-10)
    left = float(np.sum((target - scaled @ weights) ** 2)) / max(len(target) - 4, 1)
    covariance = np.linalg.pinv(scaled.T @ scaled)
    return float(weights[0] / scale[0]), math.sqrt(max(left * float(covariance[0, 0]), 0.0)) / float(scale[0])

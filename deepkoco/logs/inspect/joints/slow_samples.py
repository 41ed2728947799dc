"""What slow motion in the logs says of the signs and zeros of the joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.logs.inspect.joints.goals import hold
from deepkoco.logs.inspect.joints.gravity import SLOW, JointEvidence, Slow, signs_and_zeros
from deepkoco.logs.inspect.joints.proposed_joint import (
    ProposedJoint,
    driving_commands,
    effort_column,
    joint_slides,
    model_positions,
)
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.systems import System

STEP = 0.1  # between compared samples [s]
SPREAD = 0.15  # half of the time over which a speed is taken [s]


def gravity_evidence(
    surveys: Sequence[Survey], system: System, joints: Sequence[ProposedJoint]
) -> list[JointEvidence] | None:
    parts = [part for survey in surveys if (part := _slow(survey, system, joints)) is not None]
    if not parts:
        return None
    slow = Slow(
        np.concatenate([part.q for part in parts]),
        np.concatenate([part.speed for part in parts]),
        np.concatenate([part.pull for part in parts]),
        sum(part.seconds for part in parts),
    )
    return signs_and_zeros(system, slow, [not joint_slides(system, j) for j in range(system.joints)])


def _slow(survey: Survey, system: System, joints: Sequence[ProposedJoint]) -> Slow | None:
    """Samples of one log at which all joints are slow."""
    there = {column.label: column for column in survey.columns if column.usable}
    samples = []
    for joint in joints:
        column = there.get(joint.log.columns["position"].label)
        if column is None or len(survey.samples(column)[0]) < 2:
            return None
        samples.append(survey.samples(column))
    if not samples:
        return None
    start, stop = max(t[0] for t, _ in samples) + 0.5, min(t[-1] for t, _ in samples) - 0.5
    times = np.arange(start, stop, STEP)
    q, speed = np.zeros((len(times), system.joints)), np.zeros((len(times), system.joints))
    pull = np.full((len(times), system.joints), np.nan)
    for joint, (t, value) in zip(joints, samples, strict=True):
        q[:, joint.number] = model_positions(joint, np.interp(times, t, value))
        ahead, behind = (np.interp(times + s, t, value) for s in (SPREAD, -SPREAD))
        speed[:, joint.number] = joint.scaling.factor * (ahead - behind) / (2.0 * SPREAD)
        pull[:, joint.number] = _pull(survey, system, joint, there, times, q[:, joint.number])
    keep = (np.abs(speed) < SLOW).all(axis=1)
    return Slow(q[keep], speed[keep], pull[keep], STEP * float(keep.sum()))


def _pull(
    survey: Survey,
    system: System,
    joint: ProposedJoint,
    there: dict[str, ColumnSurvey],
    times: np.ndarray,
    q: np.ndarray,
) -> np.ndarray:
    """Position minus goal where the joint has a servo, else minus the commanded torque; NaN if neither is there."""
    unknown = np.full(len(times), np.nan)
    driving = driving_commands(system, joint.number)
    if not driving:
        return unknown
    servo = driving[0].unit == system.state_units[joint.number]
    column = joint.log.columns.get("goal") if servo else effort_column(joint.log)
    column = None if column is None else there.get(column.label)
    if column is None:
        return unknown
    t, value = survey.samples(column)
    if not len(t):
        return unknown
    if not servo:
        return -hold(times, t, value)
    tracking = joint.tracking
    delay = tracking.delay if tracking is not None and tracking.follows else 0.1
    direction = -1.0 if tracking is not None and tracking.follows and tracking.slope < 0 else 1.0
    return q - model_positions(joint, direction * hold(times - delay, t, value))

"""What an inspection found of one joint."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deepkoco.logs.inspect.joints.goals import Tracking
from deepkoco.logs.inspect.joints.gravity import JointEvidence


@dataclass(frozen=True)
class JointFinding:
    """One joint of the model and its joint in the log.

    Attributes:
        model: name of the joint in the model.
        log: name of the joint in the log.
        probability: of this pair.
        reason: reason for this pair.
        unit: unit of the positions.
        factor: SI value of 1 in the log, without the direction.
        sign: 1 or -1, direction of the joint in the log against the model's.
        zero: coordinate of the model where the log says 0 [rad or m].
        sign_known, zero_known: whether the log shows them; else they are assumed.
        why_sign, why_zero: what supports them, or why they are not known.
        tracking: relation of the position to its goal, both in SI in the frame of the log.
        gravity: what gravity says, None if it cannot be used.
        notes: possible mistakes.
    """

    model: str
    log: str
    probability: float
    reason: str
    unit: str
    factor: float
    sign: int
    zero: float
    sign_known: bool
    zero_known: bool
    why_sign: str
    why_zero: str
    tracking: Tracking | None
    gravity: JointEvidence | None
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, object]:
        """The finding in plain values."""
        track, pull = self.tracking, self.gravity
        return {
            "joint": self.model,
            "joint_in_log": self.log,
            "probability": self.probability,
            "reason": self.reason,
            "unit": self.unit,
            "factor": self.factor,
            "sign": self.sign,
            "sign_known": self.sign_known,
            "why_sign": self.why_sign,
            "zero": self.zero,
            "zero_known": self.zero_known,
            "why_zero": self.why_zero,
            "follows_goal": None if track is None else track.follows,
            "delay_s": None if track is None else track.delay,
            "slope": None if track is None else track.slope,
            "sag": None if track is None else track.offset,
            "gravity_explains": None if pull is None else pull.explained,
            "notes": list(self.notes),
        }


def from_ranges(
    low: float, high: float, least: float, most: float, turns: bool
) -> tuple[int, float, str] | None:
    """Direction and zero that put the positions of a log into the range of the model.

    Args:
        low, high: range of the model's joint.
        least, most: range of the log, in SI in its own frame.
        turns: whether the joint turns.

    Returns:
        Sign, zero and the reason, if the log does not fit as it is; None if it fits, or if nothing else fits better.
    """
    slack = 0.02 * (high - low)
    if not math.isfinite(high - low) or (low - slack <= least and most <= high + slack):
        return None
    said = f"the log spans {least:.3g} to {most:.3g}, the model {low:.3g} to {high:.3g}"
    if low - slack <= -most and -least <= high + slack:
        return -1, 0.0, f"{said}; only the other direction fits"
    if most - least > high - low + 2.0 * slack:
        return None
    shift_low, shift_high = low - slack - least, high + slack - most
    quarter = 0.5 * math.pi
    if turns:
        quarters = [k * quarter for k in range(-8, 9) if shift_low <= k * quarter <= shift_high]
        if quarters:
            return 1, min(quarters, key=abs), f"{said}; a shift by whole quarters of a turn fits"
    return 1, 0.5 * (shift_low + shift_high), f"{said}; only a shift fits"

"""Units of the positions and speeds of joints."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.logs.checks.derivative import relate
from deepkoco.logs.inspect.evidence import SPEEDS, Samples
from deepkoco.logs.inspect.survey import ColumnSurvey
from deepkoco.logs.units import factor_between

ROOM = 1.15  # a log may span this much of the model's range
TICKS = 4096  # of a turn, of most servos of hobby robots
PERCENT = 100.5  # largest number of a position in per cent of its range
RELATED = 0.3  # agreement below which a column is not the derivative of the position
DERIVED = "in this unit it is the derivative of the position"  # what values say of the unit of a speed
NEAR = 0.15  # tolerance of the logarithm of a ratio of units


class Scaling(NamedTuple):
    """SI value = factor_between(unit) * (scale * number + offset), without the direction of the joint."""

    unit: str
    scale: float
    offset: float
    stated: bool
    note: str = ""

    @property
    def factor(self) -> float:
        """SI value of 1."""
        return self.scale * factor_between(
            self.unit, "rad" if self.unit in ("rad", "deg", "rev", "mrad") else "m"
        )


def position_scaling(
    column: ColumnSurvey, value: np.ndarray, low: float, high: float, slides: bool
) -> Scaling:
    """Unit of a column of positions, from its name, its range and the range of the model's joint."""
    si = "m" if slides else "rad"
    if column.hints.unit is not None:
        return Scaling(column.hints.unit, 1.0, 0.0, True)
    span = float(np.ptp(value)) if len(value) else 0.0
    reach = high - low if math.isfinite(high - low) else (10.0 if slides else 2.2 * math.pi)
    if slides:
        return Scaling("mm" if span > ROOM * reach else "m", 1.0, 0.0, False)
    whole = bool(np.all(value == np.round(value)))
    if whole and span > 50 and value.min() >= 0 and value.max() < TICKS:
        turn = 2.0 * math.pi / TICKS
        return Scaling(
            si, turn, -math.pi, False, f"whole numbers from 0 to {TICKS - 1}: read as ticks of a turn"
        )
    if span <= ROOM * reach and span < 20.0:
        return Scaling(si, 1.0, 0.0, False)
    if math.radians(span) <= ROOM * reach:
        inside = float(np.abs(value).max()) <= PERCENT
        note = (
            "could also be per cent of the joint's range, as LeRobot writes without use_degrees"
            if inside
            else ""
        )
        return Scaling("deg", 1.0, 0.0, False, note)
    if float(np.abs(value).max()) <= PERCENT:
        signed = float(value.min()) < -0.5
        scale = reach / (200.0 if signed else 100.0)
        offset = 0.5 * (low + high) if signed else low
        return Scaling(si, scale, offset, False, "read as per cent of the joint's range")
    return Scaling("deg", 1.0, 0.0, False)


def alike(scalings: list[Scaling], turning: list[bool]) -> list[Scaling]:
    """The same unit for all joints that turn, if the names do not state it: a recorder uses one."""
    free = [k for k, s in enumerate(scalings) if turning[k] and not s.stated]
    if any(scalings[k].unit == "deg" for k in free):
        for k in free:
            if scalings[k].unit == "rad" and scalings[k].scale == 1.0:
                scalings[k] = Scaling("deg", 1.0, 0.0, False, "in deg, because other joints are")
    return scalings


def speed_scaling(position: Samples, column: ColumnSurvey, speed: Samples, slides: bool) -> Scaling | None:
    """Unit of a column of speeds; None if it is not the derivative of the position [SI]."""
    units = SPEEDS["velocity" if slides else "angular velocity"]
    si = units[0]
    relation = relate(*position, *speed)
    still = relation is None or not relation.moved or not math.isfinite(relation.ratio)
    if relation is None or still:
        return Scaling(column.hints.unit or si, 1.0, 0.0, column.hints.unit is not None) if still else None
    if relation.agreement < RELATED or relation.ratio <= 0:
        return None
    if column.hints.unit is not None:
        return Scaling(column.hints.unit, 1.0, 0.0, True)
    near = [u for u in units if abs(math.log(relation.ratio / factor_between(u, si))) < NEAR]
    return Scaling(near[0], 1.0, 0.0, False, DERIVED) if near else Scaling(si, relation.ratio, 0.0, False)

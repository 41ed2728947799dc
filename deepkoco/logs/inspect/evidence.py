"""Evidence of the values: which column is the derivative of which, and which one drives the motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from deepkoco.logs.checks.derivative import Relation, relate
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import factor_between

MOST_ROWS = 20_000  # rows of a column that are compared
MOST_COLUMNS = 48  # up to this number all pairs are compared, above it only pairs whose names fit
STRIDE = 0.2  # changes of speed are explained over this time [s]; sensor noise dominates shorter changes
AGREES = 0.6  # agreement above which the ratio is significant
TOLERANCE = 0.08  # standard deviation of the logarithm of a ratio of units
POSITIONS = {"angle": ("rad", "deg", "rev", "mrad"), "length": ("m", "mm", "cm", "um")}
SPEEDS = {
    "angular velocity": ("rad/s", "deg/s", "rpm", "rev/s", "mrad/s"),
    "velocity": ("m/s", "mm/s", "cm/s"),
}
TIMES = ("s", "ms", "us", "ns")
# Ranges above which a unit is less likely, in that unit.
COMMON = {"rad": 60.0, "deg": 20_000.0, "rad/s": 150.0, "deg/s": 9_000.0, "m": 100.0, "m/s": 50.0}

Samples = tuple[np.ndarray, np.ndarray]


class Units(NamedTuple):
    """Units of a position, its speed and the time column, and the margin to the second best units [nats]."""

    position: str
    speed: str
    time: str
    margin: float


def samples_of(survey: Survey) -> dict[str, Samples]:
    """Label -> stamps and values of every column that can be a channel."""
    result = {}
    for column in survey.columns:
        if column.usable:
            t, value = survey.samples(column)
            result[column.label] = (t[:MOST_ROWS], value[:MOST_ROWS])
    return result


def derivatives(
    columns: list[ColumnSurvey], samples: Mapping[str, Samples]
) -> dict[tuple[str, str], Relation]:
    """Compute the relations of all pairs (position, speed) that their names do not exclude."""
    moving = [c for c in columns if c.kind == "number" and len(samples[c.label][0]) > 10]
    few = len(moving) <= MOST_COLUMNS
    firsts = [c for c in moving if _may_measure(c, ("angle", "length", "angular velocity"), few)]
    seconds = [
        c for c in moving if _may_measure(c, ("angular velocity", "velocity", "angular acceleration"), few)
    ]
    found = {}
    for first, second in product(firsts, seconds):
        if first.label == second.label:
            continue
        relation = relate(*samples[first.label], *samples[second.label])
        if relation is not None:
            found[first.label, second.label] = relation
    return found


def drives(angle: Samples, speed: Samples | None, inputs: Mapping[str, Samples]) -> dict[str, float]:
    """Share of a joint's changes of speed that each input explains, beyond gravity and friction.

    Changes of the speed over 0.2 s are regressed on the integrals of five terms, without and with the input. The terms
    are sin and cos of the angle, the speed, its smoothed sign and a constant. The input holds from its
    stamp to the next. The share is the relative decrease of the sum of squared residuals.

    Args:
        angle: stamps [s] and angles [rad].
        speed: stamps [s] and speeds [rad/s]; None takes the gradient of the angle.
        inputs: name -> stamps [s] and values of each candidate.
    """
    t, turn = angle
    if len(t) < 40:
        return {}
    rate = np.gradient(turn, t) if speed is None else np.interp(t, *speed)
    step = np.diff(t)
    stride = int(max(2, round(STRIDE / float(np.median(step)))))
    if len(t) < 4 * stride:
        return {}
    whole = (t[stride:] - t[:-stride]) < 2.0 * float(np.median(t[stride:] - t[:-stride]))
    change = (rate[stride:] - rate[:-stride])[whole]
    base = [
        np.sin(turn),
        np.cos(turn),
        rate,
        np.tanh(rate / max(0.05 * float(np.std(rate)), 1e-9)),
        np.ones(len(t)),
    ]
    matrix = np.stack([_integral(f, t, stride)[whole] for f in base], axis=1)
    left = _residual(matrix, change)
    result = {}
    for name, (stamps, value) in inputs.items():
        if len(stamps) < 2 or np.ptp(value) == 0:
            continue
        held = value[np.maximum(np.searchsorted(stamps, t, side="right") - 1, 0)]
        column = _integral(held, t, stride)[whole][:, None]
        more = _residual(np.concatenate([matrix, column], axis=1), change)
        result[name] = 1.0 - more / left if left > 0 else 0.0
    return result


def choose_units(
    position: ColumnSurvey,
    speed: ColumnSurvey,
    quantities: tuple[str, str],
    relation: Relation,
    time: str,
    named: bool,
) -> Units:
    """Most likely units of a position and its speed, from names, the ratio of the two, and their ranges.

    Args:
        position, speed: the columns.
        quantities: their quantities, such as ("angle", "angular velocity").
        relation: their relation as written in the file, with the time in the unit `time`.
        time: assumed unit of the time.
        named: whether the name of the time column states this unit.
    """
    scored = []
    for first, second, clock in product(POSITIONS[quantities[0]], SPEEDS[quantities[1]], TIMES):
        score = _prior(position, first) + _prior(speed, second)
        score += 0.0 if clock == time else -20.0 if named else -3.0
        if relation.agreement > AGREES and math.isfinite(relation.ratio) and relation.ratio != 0:
            # The relation assumes the time in `time`. In `clock`, every integral is larger by their ratio.
            wanted = factor_between(second, SPEEDS[quantities[1]][0]) / factor_between(
                first, POSITIONS[quantities[0]][0]
            )
            wanted *= factor_between(clock, "s") / factor_between(time, "s")
            off = math.log(abs(relation.ratio) / wanted) / TOLERANCE
            score -= min(0.5 * off**2, 12.0)
        scored.append((score, first, second, clock))
    scored.sort(key=lambda entry: -entry[0])
    _, first, second, clock = scored[0]
    return Units(first, second, clock, scored[0][0] - scored[1][0])


def _prior(column: ColumnSurvey, unit: str) -> float:
    if column.hints.unit is not None:
        return 0.0 if factor_of(column.hints.unit) == factor_of(unit) else -30.0
    score = {"rad": 1.0, "rad/s": 1.0, "m": 1.0, "m/s": 1.0, "deg": 0.0, "deg/s": 0.0}.get(unit, -2.0)
    span = (column.high or 0.0) - (column.low or 0.0)
    limit = COMMON.get(unit)
    return score - (2.5 if limit is not None and span > limit else 0.0)


def factor_of(unit: str) -> tuple[str, float]:
    """Quantity and SI value of a unit, equal for all its spellings."""
    from deepkoco.logs.units import parse_unit

    found = parse_unit(unit)
    return found.quantity, found.factor


def _may_measure(column: ColumnSurvey, quantities: tuple[str, ...], unknown: bool) -> bool:
    if column.hints.unit is not None:
        return factor_of(column.hints.unit)[0] in quantities
    says = [column.hints.speaks_for(q) for q in quantities]
    return max(says) > 0 or (unknown and max(says) == 0)


def _integral(value: np.ndarray, t: np.ndarray, stride: int) -> np.ndarray:
    total = np.append(0.0, np.cumsum(value[:-1] * np.diff(t)))
    return total[stride:] - total[:-stride]


def _residual(matrix: np.ndarray, target: np.ndarray) -> float:
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    weights, *_ = np.linalg.lstsq(matrix / scale, target, rcond=1e-10)
    return float(np.sum((target - matrix / scale @ weights) ** 2))

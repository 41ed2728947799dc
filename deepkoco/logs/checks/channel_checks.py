"""Check the channels of a log: number of samples, constant sensors, units that contradict each other."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from deepkoco.logs.checks.derivative import Relation, relate, slip
from deepkoco.logs.formats.log_file import LogError, TooLittleError
from deepkoco.logs.series import Series
from deepkoco.logs.sidecar import ChannelColumn
from deepkoco.logs.units import parse_unit

RATIO = 2.0  # above this ratio of an angle's changes to its integrated speed, a unit is wrong
AGREES = 0.6  # agreement above which the ratio is significant
APART = 0.1  # agreement below which an angle and a speed are unrelated
MOVES = 8.0  # change of a moving angle [quanta]
STANDS = 4.0  # change below which a joint is taken to stand still [noise standard deviations]
TURNS = 200.0  # range above which an angle is probably in degrees [rad]
LOST = 0.01  # integral of an unknown change of the command above which a step is a gap [typical command s]
_DERIVATIVES = {"rad": "rad/s", "m": "m/s", "rad/s": "rad/s^2", "m/s": "m/s^2"}

Span = tuple[float, float]


def check_content(
    path: Path, channels: Mapping[str, Series], min_samples: int, min_seconds: float, constant_command: bool
) -> None:
    """Check that a log contains enough samples, time and changes of the command.

    Raises:
        TooLittleError: a channel has too few samples, all together cover too short a time, or no command changes.
        LogError: channels do not overlap.
    """
    driven = any(s.kind == "command" and len(s) and np.ptp(s.value) > 0 for s in channels.values())
    for name, series in channels.items():
        wanted = min_samples if series.kind == "measurement" else 1
        if len(series) < wanted:
            raise TooLittleError(
                f'{path}: channel "{name}" is too short: {len(series)} samples, at least {wanted} needed; '
                "record for longer"
            )
        if series.kind == "command" and not constant_command and not driven and np.ptp(series.value) == 0:
            raise TooLittleError(
                f'{path}: command "{name}" is constant ({series.value[0]:g} {series.unit}); a fit '
                "needs a command that changes; record with an excitation (chirp, steps, prbs)"
            )
    measured = [series for series in channels.values() if series.kind == "measurement"]
    if not measured:
        return
    start, stop = max(float(s.t[0]) for s in measured), min(float(s.t[-1]) for s in measured)
    seconds = stop - start
    if seconds < min_seconds:
        raise TooLittleError(
            f"{path}: too short: all measurements together cover {max(seconds, 0.0):.3g} s, at least "
            f"{min_seconds:g} s needed; if the log is longer, check the unit of the time column"
        )
    for name, series in channels.items():
        outside = series.t[0] > stop or series.t[-1] < start - max(seconds, 0.0)
        if series.kind == "command" and outside:
            raise LogError(
                f'{path}: command "{name}" ({series.t[0]:.6g} to {series.t[-1]:.6g} s) lies outside '
                f"the measurements ({start:.6g} to {stop:.6g} s); check the units and clocks of the time columns"
            )


def check_units(
    path: Path,
    channels: Mapping[str, Series],
    columns: Mapping[str, ChannelColumn],
    pairs: Sequence[tuple[str, str]] | None = None,
) -> list[str]:
    """Compare each position with its integrated speed, and the range of each angle with `TURNS`.

    Args:
        path: the log.
        channels: its channels.
        columns: where they come from.
        pairs: positions with their speeds; None finds them by units and names.

    Returns:
        Warnings about possible mistakes.

    Raises:
        LogError: two channels contradict each other, or a range is implausible: a unit, a scale or a mapping is wrong.
    """
    doubts = []
    for first, second in derivative_pairs(channels) if pairs is None else pairs:
        if columns[first].checked or columns[second].checked:
            continue
        a, b = channels[first], channels[second]
        relation = relate(a.t, a.value, b.t, b.value)
        if relation is not None and (
            doubt := _contradiction(path, (first, a), (second, b), relation, columns)
        ):
            doubts.append(doubt)
    for name, series in channels.items():
        span = float(np.ptp(np.unwrap(series.value))) if series.unit == "rad" else 0.0
        if columns[name].checked or series.kind != "measurement" or _in_degrees(columns[name]):
            continue
        # Unwrapping takes the steps of a wrong scale for turns. A few glitches do not make an angle implausible.
        bulk = float(np.ptp(np.quantile(series.value, [0.02, 0.98]))) if series.unit == "rad" else 0.0
        if (span > TURNS and np.ptp(series.value) > TURNS) or bulk > TURNS:
            raise LogError(
                f'{path}: channel "{name}" (column "{columns[name].value.name}") spans {np.ptp(series.value):.4g} rad, '
                f"{np.ptp(series.value) / (2 * math.pi):.0f} turns; if it is in deg, correct its unit in the sidecar; "
                'if it is right, write "checked: true" there'
            )
    return doubts


def _in_degrees(column: ChannelColumn) -> bool:
    """Whether a 1 of an angle's column is declared to be a degree or less, in its unit or as counts of an encoder.

    No usual unit is smaller, so a long range is that of a motor.
    """
    unit = parse_unit(column.value.unit)
    return unit.quantity == "angle" and min(abs(column.scale), 1.0) * unit.factor <= parse_unit("deg").factor


def derivative_pairs(channels: Mapping[str, Series]) -> list[tuple[str, str]]:
    """Pairs of measured channels in which the second is the derivative of the first.

    They are paired by their units, and of several by their names: `q_elbow` with `dq_elbow`, `theta2` with `omega2`.
    """
    pairs = []
    measured = {name: series for name, series in channels.items() if series.kind == "measurement"}
    for first, series in measured.items():
        rates = [n for n, s in measured.items() if s.unit == _DERIVATIVES.get(series.unit)]
        alike = [n for n in measured if measured[n].unit == series.unit]
        if len(rates) == 1 and len(alike) == 1:
            pairs.append((first, rates[0]))
        else:
            named = [n for n in rates if n == f"d{first}"]
            number = None if named else re.search(r"\d+$", first)
            pairs += [(first, n) for n in named]
            pairs += [(first, n) for n in rates if number and n.endswith(number.group())]
    return pairs


def _contradiction(
    path: Path,
    position: tuple[str, Series],
    speed: tuple[str, Series],
    relation: Relation,
    columns: Mapping[str, ChannelColumn],
) -> str | None:
    (first, a), (second, b) = position, speed
    said = (
        f'{path}: channel "{first}" (column "{columns[first].value.name}", {columns[first].value.unit}) and channel '
        f'"{second}" (column "{columns[second].value.name}", {columns[second].value.unit})'
    )
    remedy = 'correct the sidecar, or write "checked: true" at both channels if they are right'
    quantum = smallest_step(a.value)
    total = relation.integral
    if np.ptp(a.value) == 0.0 or np.ptp(b.value) == 0.0:
        dead = first if np.ptp(a.value) == 0.0 else second
        moves = (
            total > MOVES * max(quantum, 1e-3)
            if dead == first
            else relation.moved > MOVES * max(quantum, 1e-6)
        )
        if moves or (dead == first and np.ptp(b.value) > 1.0):
            raise LogError(
                f'{said}: "{dead}" never changes while the other does; a dead sensor or a wrong column; {remedy}'
            )
        return None
    if not relation.moved > MOVES * quantum:
        return None
    if relation.agreement > AGREES:
        if 1.0 / RATIO < relation.ratio < RATIO:
            return None
        meaning = slip(relation.ratio)
        raise LogError(
            f"{said}: the first changes by {relation.ratio:.4g} times the integral of the second, not by 1; "
            f"{meaning or 'a unit or a gear ratio (key scale) is wrong'}; {remedy}"
        )
    if relation.moved < STANDS * _noise(a.value):
        return None
    turned = relate(b.t, b.value, a.t, a.value)
    if turned is not None and turned.agreement > AGREES and 1.0 / RATIO < turned.ratio < RATIO:
        raise LogError(
            f"{said}: the first is the derivative of the second (agreement {turned.agreement:.2f} of 1, against "
            f"{max(relation.agreement, 0):.2f} for the reverse); the two columns are swapped; {remedy}"
        )
    if relation.agreement < APART:
        raise LogError(
            f"{said}: the second is not the derivative of the first (agreement {max(relation.agreement, 0):.2f} of 1); "
            f"a column or a clock is wrong, or samples are frozen; {remedy}"
        )
    return (
        f'"{second}" differs much from the derivative of "{first}" (agreement {relation.agreement:.2f} of 1); look at '
        "the log with deepkoco inspect"
    )


def smallest_step(value: np.ndarray) -> float:
    """Smallest difference between two different samples, 0 for a constant."""
    steps = np.diff(np.unique(value))
    return float(steps.min()) if len(steps) else 0.0


def _noise(value: np.ndarray) -> float:
    """Standard deviation of the noise, from the median of second differences, which is robust against jumps."""
    return float(np.median(np.abs(np.diff(value, 2)))) / (0.6745 * math.sqrt(6.0)) if len(value) > 2 else 0.0


def unknown_stretches(channels: Mapping[str, Series]) -> tuple[Span, ...]:
    """Stretches [s] in which a command is unknown or a measurement is filled in; fits leave them out."""
    spans: list[Span] = []
    for series in channels.values():
        if series.unknown is not None:
            spans += [(float(a), float(b)) for a, b in series.unknown]
        if series.kind == "command":
            spans += gaps_in_command(series)
    return tuple(sorted(spans))


def gaps_in_command(series: Series) -> list[Span]:
    """Gaps [s] in a regularly sampled command that changes over them; a command logged at changes only has none."""
    if len(series) < 20:
        return []
    step = np.diff(series.t)
    base = float(np.median(step))
    regular = float(np.mean(step < 1.5 * base)) > 0.7 or bool(np.any(np.diff(series.value) == 0))
    if not regular or base <= 0:
        return []
    typical = float(np.sqrt(np.mean((series.value - series.value.mean()) ** 2)))
    jump = np.abs(np.diff(series.value))
    # Over several lost samples, the command can have changed and returned.
    jump = np.where(step > 3.5 * base, np.maximum(jump, typical), jump)
    lost = (step > 1.5 * base) & (jump * (step - base) > LOST * typical)
    return [(float(series.t[k] + base), float(series.t[k + 1])) for k in np.flatnonzero(lost)]

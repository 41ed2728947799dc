"""Units of positions and goals that neither a name nor a speed states: those in which the equations hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.counts import ARCS, PER_TURN, Counts, in_counts, signless, turn_of
from deepkoco.logs.inspect.evidence import Samples
from deepkoco.logs.units import factor_between, parse_unit
from deepkoco.systems import Motion, System

UNITS = {"angle": ("rad", "deg", "rev"), "length": ("m", "mm", "cm")}
POWERS = (1.0, 1e-3, 1e3)  # of ten by which an effort may be written
# Factors of other units in which a goal of a speed may be written: degrees and turns, parts of a metre.
RATES = {"angular velocity": (math.pi / 180.0, math.pi / 30.0, 2.0 * math.pi), "velocity": (1e-3, 1e-2)}
MOST_DOUBTFUL = 3  # positions and goals whose units are tried together
MOST_POINTS = 4000  # of the grid of times
REACH = 0.2  # seconds on each side over which accelerations are compared
LEAST = 4  # and steps of the grid
LESS = 0.4  # share of the misfit as proposed below which other units are taken
FITS = 0.5  # misfit above which equations tell no counts: limits leave many turns, the zero may be another
HALF = 0.5  # share of the misfit in every other unit below which equations hold in one alone
ROOM = 2.0  # times its limit that a command may reach
ALIKE = 1.5  # times the misfit of the best reading below which another one is told
NEAR = 0.15  # as is one that differs from it by this share: masses and gains of the description are not exact either


class Reading(NamedTuple):
    """How the numbers of a column are read: in a unit, or as ``counts`` of a turn."""

    unit: str
    counts: Counts | None = None

    @property
    def scale(self) -> float:
        return 1.0 if self.counts is None else self.counts.scale

    def __str__(self) -> str:
        if self.counts is None:
            return self.unit
        zero = f" with zero at {self.counts.zero}" if self.counts.zero else ""
        return f"counts, {self.counts.per_turn} of them a turn{zero}"


def with_likely_units(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> Proposal:
    """Give positions and goals without a stated unit the unit in which the system's accelerations are those of the log.

    A joint of 30 deg that is read as 30 rad is accelerated 57 times as much as its actuator can. Whole numbers may
    also be counts of an encoder. The weak form avoids second differences: for a bump w of finite support, the sum of
    w'' q is that of w times the acceleration.

    Args:
        system: The system, whose measurements must show all its positions.
        proposal: Its mapping.
        samples: Label -> stamps [s] and values of each column.
    """
    positions = _positions(system, proposal)
    groups = _doubtful(system, proposal, samples)[:MOST_DOUBTFUL]
    drives = [c for c in proposal.choices if c.channel.kind == "command" and c.column is not None]
    if not groups:
        return proposal
    tried = [_readings(group, samples) for group in groups]
    best = tuple(readings[0] for readings in tried)
    alike: Sequence[Sequence[Reading] | None] = ((),) * len(groups)
    if any(len(readings) > 1 for readings in tried):
        if positions is None or len(drives) < len(system.commands):
            tried = [readings[:1] for readings in tried]
        try:
            best, alike = _best_readings(system, positions or [], groups, tried, drives, samples)
        except (RuntimeError, ValueError):  # equations that cannot be evaluated there
            return proposal
    changed = {
        c.channel.name: _read(c, reading, others)
        for group, reading, others in zip(groups, best, alike, strict=True)
        for c in group
        if reading != Reading(c.unit)
    }
    return replace(proposal, choices=tuple(changed.get(c.channel.name, c) for c in proposal.choices))


def with_units_held(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> Proposal:
    """Mark positions, speeds and commands without a stated unit, where the equations hold in these units alone.

    A recorder writes the positions of all joints that turn in one unit, those of all that slide, all efforts, and all
    goals of speeds.

    Args:
        system: The system, whose measurements must show all its positions, with a column for each command.
        proposal: Its mapping.
        samples: Label -> stamps [s] and values of each column.
    """
    shown, positions = _shown(system, proposal), _positions(system, proposal)
    drives = [c for c in proposal.choices if c.channel.kind == "command" and c.column is not None]
    # A speed follows from its position, where it is its derivative without a factor.
    free = [c for c in shown if c is not None and not c.stated and abs(c.scale) == 1.0]
    efforts = [
        c
        for c in drives
        if not c.stated and parse_unit(c.channel.unit).quantity in ("torque", "force", "ratio")
    ]
    rates = [c for c in drives if not c.stated and parse_unit(c.channel.unit).quantity in RATES]
    if not (free or efforts or rates) or positions is None or len(drives) < len(system.commands):
        return proposal
    if any(c.unit != c.channel.unit for c in free):
        return proposal
    groups = [[c for c in free if c in positions and c.unit == unit] for unit in ("rad", "m")]
    groups = [group for group in groups if group]
    if not (groups or efforts or rates):
        return proposal
    tried = [UNITS[parse_unit(group[0].unit).quantity] for group in groups]
    found: dict[tuple[tuple[str, ...], str, float], float] = {}
    kinds = {c.channel.name: parse_unit(c.channel.unit).quantity for c in rates}
    # Factor of all efforts, or of all goals of one kind of speed.
    factors = [("effort", power) for power in (POWERS if efforts else (1.0,))]
    factors += [(kind, factor) for kind in sorted(set(kinds.values())) for factor in RATES[kind]]
    for units, (kind, factor) in product(product(*tried), factors):
        taken = {c.channel.name: Reading(u) for group, u in zip(groups, units, strict=True) for c in group}
        scaled = (
            {c.channel.name for c in efforts}
            if kind == "effort"
            else {n for n, k in kinds.items() if k == kind}
        )
        given = [replace(c, scale=factor * c.scale) if c.channel.name in scaled else c for c in drives]
        try:
            found[units, kind, factor] = _misfit(system, positions, taken, given, samples)
        except (RuntimeError, ValueError):  # equations that cannot be evaluated there
            return proposal
    own = found.pop((tuple(group[0].unit for group in groups), "effort", 1.0))
    if not (own <= FITS and all(own < HALF * other for other in found.values())):
        return proposal
    known = {c.channel.name for c in (*free, *efforts, *rates)}
    choices = tuple(replace(c, held=c.channel.name in known) for c in proposal.choices)
    return replace(proposal, choices=choices)


def _read(choice: Choice, reading: Reading, alike: Sequence[Reading] | None) -> Choice:
    """The choice with a reading; ``alike`` are those that fit about as well, None where limits alone decide."""
    counts = reading.counts
    if counts is not None and counts.wraps:
        why = f"it begins again after {counts.per_turn}: ticks of a turn"
    elif alike is None:
        why = f"in {choice.unit}, commands would be far beyond their limits; of a servo's ticks, only {reading} are not"
    else:
        why = f"the equations fit it in {reading} and not in {choice.unit}"
        turns = {r.counts.per_turn for r in alike if r.counts is not None and r.counts != counts}
        others = [str(n) for n in sorted(turns - {counts.per_turn if counts is not None else 0})]
        why += f"; {' or '.join(others)} would fit about as well" if others else ""
    offset = choice.offset if counts is None else counts.offset
    return replace(
        choice, unit=reading.unit, scale=reading.scale, offset=offset, reasons=(*choice.reasons, why)
    )


def _readings(group: Sequence[Choice], samples: Mapping[str, Samples]) -> list[Reading]:
    """Ways to read the numbers of a group, the proposed one first; one alone where the numbers show it."""
    first = group[0]
    assert first.column is not None
    quantity = parse_unit(first.channel.unit).quantity
    units = [Reading(u) for u in UNITS.get(quantity, ()) if u != first.unit]
    own = samples[first.column.label]
    if in_counts(first, own):
        # A goal may step from one end to the other without beginning again.
        turn = turn_of(own[1]) if first.channel.kind == "measurement" else None
        if turn is not None:
            return [Reading("rad", turn)]
        units += [Reading("rad", Counts(n, False)) for n in sorted({*PER_TURN, *ARCS})]
        values = np.concatenate([samples[c.column.label][1] for c in group if c.column is not None])
        if values.min() >= 0.0:
            units += [Reading("rad", counts) for counts in signless(float(values.min()), float(values.max()))]
    return [Reading(first.unit), *units]


def _doubtful(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> list[list[Choice]]:
    """Choices without a stated unit that must have one: positions, and goals, with their position where both count."""
    lone = _lone(system, proposal)
    shown = _shown(system, proposal)
    groups = [[c] for c in lone]
    mapped = {c.channel.name: c for c in proposal.choices if c.column is not None}
    for command, joint in zip(system.commands, system.command_joints, strict=False):
        goal, place = mapped.get(command.name), shown[joint] if joint < len(shown) else None
        if goal is None or goal.stated or goal.column is None or command.unit != system.state_units[joint]:
            continue
        own = next((g for g in groups if place is not None and g[0] is place), None)
        counted = (
            own is not None and own[0].column is not None and in_counts(own[0], samples[own[0].column.label])
        )
        if own is not None and counted and in_counts(goal, samples[goal.column.label], least=1):
            own.append(goal)
        else:
            groups.append([goal])
    return groups


def _positions(system: System, proposal: Proposal) -> list[Choice] | None:
    """The choice of each joint's position; None unless the log shows all of them as states."""
    whole = [c for c in _shown(system, proposal)[: system.joints] if c is not None]
    return whole if len(whole) == system.joints else None


def _lone(system: System, proposal: Proposal) -> list[Choice]:
    """Positions without a stated unit and without a speed that would settle it."""
    shown = _shown(system, proposal)
    pairs = zip(shown[: system.joints], shown[system.joints :], strict=True)
    return [a for a, speed in pairs if a is not None and not a.stated and speed is None]


def _shown(system: System, proposal: Proposal) -> list[Choice | None]:
    """The choice that shows each state, None without a column."""
    if not system.shows_states:
        return [None] * (2 * system.joints)
    names = dict(zip(system.measured_states, (c.name for c in system.measurements), strict=True))
    mapped = {c.channel.name: c for c in proposal.choices if c.column is not None}
    return [mapped.get(names.get(k, "")) for k in range(2 * system.joints)]


def _best_readings(
    system: System,
    positions: list[Choice],
    groups: Sequence[Sequence[Choice]],
    tried: Sequence[Sequence[Reading]],
    drives: list[Choice],
    samples: Mapping[str, Samples],
) -> tuple[tuple[Reading, ...], Sequence[Sequence[Reading] | None]]:
    """The reading of each group, and for each group those that fit about as well; None where limits alone decide."""
    proposed, none = tuple(readings[0] for readings in tried), ((),) * len(tried)
    found: dict[tuple[Reading, ...], float] = {}
    whole: list[tuple[Reading, ...]] = []
    impossible = False
    if len(list(product(*tried))) == 1:
        return proposed, none
    for readings in product(*tried):
        # Servos that send no sign are of one make. Each reading of each beside all of the others would take minutes.
        counted = {r.counts for r in readings if r.counts is not None}
        if len(counted) > 1 and any(c.zero for c in counted):
            continue
        taken = {c.channel.name: r for group, r in zip(groups, readings, strict=True) for c in group}
        # Linear equations hold in any unit that goals and positions share: the limits of the commands then decide.
        beyond = any(_beyond(c, taken, samples) for c in drives)
        impossible = impossible or (beyond and readings == proposed)
        if not beyond and all(r.counts is not None and r.counts.zero for r in readings):
            whole.append(readings)
        misfit = math.inf if beyond else _misfit(system, positions, taken, drives, samples)
        unsure = any(not c.wraps for c in counted)
        found[readings] = math.inf if unsure and misfit > FITS else misfit
    best = min(found, key=lambda readings: found[readings])
    if not found[best] < LESS * found[proposed]:
        # Whatever a robot lacks, it is not sent far beyond its limits. One reading without a sign may be left.
        return (whole[0], (None,) * len(tried)) if impossible and len(whole) == 1 else (proposed, none)
    alike: list[set[Reading]] = [set() for _ in groups]
    for readings, misfit in found.items():
        for own, r, b in zip(alike, readings, best, strict=True):
            if r != b and (misfit < ALIKE * found[best] or abs(r.scale / b.scale - 1.0) < NEAR):
                own.add(r)
    return best, tuple(tuple(sorted(own, key=lambda r: -r.scale)) for own in alike)


def _beyond(choice: Choice, taken: Mapping[str, Reading], samples: Mapping[str, Samples]) -> bool:
    """Whether a command would be far above its limits."""
    limit = max(abs(choice.channel.low), abs(choice.channel.high))
    assert choice.column is not None
    return (
        float(np.abs(_in_si(choice, taken, samples[choice.column.label][1])).max(initial=0.0)) > ROOM * limit
    )


def _misfit(
    system: System,
    positions: list[Choice],
    taken: Mapping[str, Reading],
    drives: list[Choice],
    samples: Mapping[str, Samples],
) -> float:
    """Difference of the accelerations of the log and of the equations, 0 for equal ones and 1 for unrelated ones."""
    rows = [samples[c.column.label] for c in positions if c.column is not None]
    start, end = max(t[0] for t, _ in rows), min(t[-1] for t, _ in rows)
    step = max(float(np.median(np.diff(t))) for t, _ in rows)
    grid = start + step * np.arange(min(MOST_POINTS, int((end - start) / step)))
    q = [np.interp(grid, t, _in_si(c, taken, value)) for c, (t, value) in zip(positions, rows, strict=True)]
    efforts = [_held(c, taken, samples, grid) for c in drives]
    reach = max(LEAST, round(REACH / step))
    bump = np.pad((1.0 - np.linspace(-1.0, 1.0, 2 * reach + 1) ** 2) ** 3, 1)
    # The sum and the first moment of the second difference vanish exactly, so offsets do not count.
    second = np.diff(bump, 2) / step**2
    speeds = [np.gradient(values, step) for values in q]
    law = system.accelerations(system.default_parameters())
    angles, rates, drive = (tuple(map(torch.from_numpy, part)) for part in (q, speeds, efforts))
    predicted = law(Motion(angles, rates, drive))
    total = 0.0
    for values, wanted in zip(q, predicted, strict=True):
        seen = np.convolve(values, second, "valid")
        said = np.convolve(np.broadcast_to(wanted.detach().numpy(), grid.shape), bump[1:-1], "valid")
        size = float(np.sum(seen**2) + np.sum(said**2))
        if not math.isfinite(size):
            return math.inf
        total += float(np.sum((seen - said) ** 2)) / size if size > 0 else 0.0
    return total / len(q)


def _in_si(choice: Choice, taken: Mapping[str, Reading], value: np.ndarray) -> np.ndarray:
    reading = taken.get(choice.channel.name, Reading(choice.unit))
    counts = reading.counts
    si = value * (choice.scale if counts is None else counts.scale)
    si = (si + (choice.offset if counts is None else counts.offset)) * factor_between(
        reading.unit, choice.channel.unit
    )
    return np.unwrap(si) if counts is not None and counts.wraps else si


def _held(
    choice: Choice, taken: Mapping[str, Reading], samples: Mapping[str, Samples], grid: np.ndarray
) -> np.ndarray:
    assert choice.column is not None
    t, value = samples[choice.column.label]
    return _in_si(choice, taken, value)[np.maximum(np.searchsorted(t, grid, side="right") - 1, 0)]

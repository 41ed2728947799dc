"""Units of positions that neither a name nor a speed states: those in which the equations of the system hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
import torch

from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.evidence import Samples
from deepkoco.logs.units import factor_between, parse_unit
from deepkoco.systems import Motion, System

UNITS = {"angle": ("rad", "deg", "rev"), "length": ("m", "mm", "cm")}
MOST_DOUBTFUL = 3  # positions whose units are tried together
MOST_POINTS = 4000  # of the grid of times
REACH = 0.2  # seconds on each side over which accelerations are compared
LEAST = 4  # and steps of the grid
LESS = 0.4  # share of the misfit as proposed below which other units are taken


def with_likely_units(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> Proposal:
    """Give positions without a stated unit the unit in which the system's accelerations are those of the log.

    A joint of 30 deg that is read as 30 rad is accelerated 57 times as much as its actuator can. The weak form avoids
    second differences: for a bump w of finite support, the sum of w'' q is that of w times the acceleration.

    Args:
        system: The system, whose measurements must show all its positions.
        proposal: Its mapping.
        samples: Label -> stamps [s] and values of each column.
    """
    positions = _positions(system, proposal)
    doubtful = _lone(system, proposal)[:MOST_DOUBTFUL]
    drives = [c for c in proposal.choices if c.channel.kind == "command" and c.column is not None]
    if positions is None or not doubtful or len(drives) < len(system.commands):
        return proposal
    try:
        best = _best_units(system, positions, doubtful, drives, samples)
    except (RuntimeError, ValueError):  # equations that cannot be evaluated there
        return proposal
    changed = {c.channel.name: unit for c, unit in zip(doubtful, best, strict=True) if unit != c.unit}
    why = "the equations fit it in {} and not in {}"
    choices = [
        c
        if c.channel.name not in changed
        else replace(
            c,
            unit=changed[c.channel.name],
            reasons=(*c.reasons, why.format(changed[c.channel.name], c.unit)),
        )
        for c in proposal.choices
    ]
    return replace(proposal, choices=tuple(choices))


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


def _best_units(
    system: System,
    positions: list[Choice],
    doubtful: list[Choice],
    drives: list[Choice],
    samples: Mapping[str, Samples],
) -> tuple[str, ...]:
    tried = product(*((c.unit, *_others(c)) for c in doubtful))
    found = {units: _misfit(system, positions, doubtful, units, drives, samples) for units in tried}
    as_proposed = found[tuple(c.unit for c in doubtful)]
    best = min(found, key=lambda units: found[units])
    return best if found[best] < LESS * as_proposed else tuple(c.unit for c in doubtful)


def _others(choice: Choice) -> tuple[str, ...]:
    units = UNITS.get(parse_unit(choice.channel.unit).quantity, ())
    return tuple(u for u in units if u != choice.unit)


def _misfit(
    system: System,
    positions: list[Choice],
    doubtful: list[Choice],
    units: tuple[str, ...],
    drives: list[Choice],
    samples: Mapping[str, Samples],
) -> float:
    """Difference of the accelerations of the log and of the equations, 0 for equal ones and 1 for unrelated ones."""
    assumed = {c.channel.name: unit for c, unit in zip(doubtful, units, strict=True)}
    rows = [samples[c.column.label] for c in positions if c.column is not None]
    start, end = max(t[0] for t, _ in rows), min(t[-1] for t, _ in rows)
    step = max(float(np.median(np.diff(t))) for t, _ in rows)
    grid = start + step * np.arange(min(MOST_POINTS, int((end - start) / step)))
    q = [
        np.interp(grid, t, value * factor_between(assumed.get(c.channel.name, c.unit), c.channel.unit))
        for c, (t, value) in zip(positions, rows, strict=True)
    ]
    efforts = [_held(c, samples, grid) for c in drives]
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


def _held(choice: Choice, samples: Mapping[str, Samples], grid: np.ndarray) -> np.ndarray:
    assert choice.column is not None
    t, value = samples[choice.column.label]
    held = value[np.maximum(np.searchsorted(t, grid, side="right") - 1, 0)]
    return held * factor_between(choice.unit, choice.channel.unit)

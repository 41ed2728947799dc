"""Range of the healthy logs: a log that goes beyond it shows what no healthy log can vouch for."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.residuals.residuals import modelled_path
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem

MARGIN = 0.1  # share of its width by which a range is widened before a value is outside
OFTEN = 0.05  # share of the samples outside from which it is said
MOST_NAMED = 3
RARE = 0.005  # share of the samples at either end of a range that is left out


class Beyond(NamedTuple):
    """A quantity that goes beyond the healthy logs.

    Attributes:
        name: State or command.
        unit: Its unit.
        low, high: Range in this log, in that unit.
        healthy_low, healthy_high: Range in the healthy logs, in that unit.
        share: Share of the samples outside of the latter.
    """

    name: str
    unit: str
    low: float
    high: float
    healthy_low: float
    healthy_high: float
    share: float


def beyond_healthy(start: Baseline, problem: FitProblem, fit: Fit) -> list[Beyond]:
    """Return the states and commands that often lie outside of what the healthy logs cover, the farthest first.

    A turning joint that the healthy logs turn once around has no range of angles.

    Args:
        start: The baseline; without healthy logs nothing is beyond them.
        problem: Windows of the log.
        fit: The model that describes its motion best.
    """
    healthy = start.healthy
    if healthy is None or fit.diverged:
        return []
    system = start.system.base
    known = modelled_path(FitProblem(start.system, healthy.windows), healthy.fit)
    now = modelled_path(problem, fit)
    found = []
    for s, (name, unit) in enumerate(zip(system.state_names, system.state_units, strict=True)):
        usual = known[..., s]
        if unit != "rad" or float(np.ptp(usual)) < 2.0 * math.pi:
            found.append(_beyond(name, unit, now[..., s], usual))
    # Also of switches and supplies: a drive that is off is a motion of its own.
    for k, command in enumerate(system.commands):
        found.append(
            _beyond(command.name, command.unit, _sent(problem.windows, k), _sent(healthy.windows, k))
        )
    return sorted((b for b in found if b.share > OFTEN), key=lambda b: -b.share)


def range_advice(start: Baseline, problem: FitProblem, fit: Fit) -> tuple[str, ...]:
    """Return a sentence about what goes beyond the healthy logs.

    Args:
        start, problem, fit: As for :func:`beyond_healthy`.
    """
    found = beyond_healthy(start, problem, fit)[:MOST_NAMED]
    if not found:
        return ()
    told = "; ".join(
        f"{b.name} is {b.low:.3g} to {b.high:.3g} {b.unit} here and {b.healthy_low:.3g} to {b.healthy_high:.3g} there "
        f"({b.share:.0%} of the samples outside)"
        for b in found
    )
    return (
        f"This log goes beyond the healthy logs: {told}. What the simulation gets wrong there may be no fault; record "
        "healthy logs that go as far.",
    )


def _beyond(name: str, unit: str, now: np.ndarray, usual: np.ndarray) -> Beyond:
    usual, now = usual[np.isfinite(usual)], now[np.isfinite(now)]
    if not usual.size or not now.size:
        return Beyond(name, unit, 0.0, 0.0, 0.0, 0.0, 0.0)
    # A few samples at the starts of windows, where initial states are fitted, are no range.
    low, high = np.quantile(usual, RARE), np.quantile(usual, 1.0 - RARE)
    margin = MARGIN * (high - low)
    outside = ((now < low - margin) | (now > high + margin)).mean()
    least, most = np.quantile(now, RARE), np.quantile(now, 1.0 - RARE)
    return Beyond(name, unit, float(least), float(most), float(low), float(high), float(outside))


def _sent(windows: Windows, command: int) -> np.ndarray:
    logs = np.unique(windows.log)
    return np.concatenate([windows.commands[k].column(command) for k in logs]) if len(logs) else np.zeros(0)

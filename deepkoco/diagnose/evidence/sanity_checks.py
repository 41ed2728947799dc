"""Sanity checks of selected causes: reasons for naming no cause although one fits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import CAUSES, Cause, is_changed
from deepkoco.diagnose.diagnosis import Finding
from deepkoco.diagnose.residuals.friction_curve import friction_curve, pushes
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.systems import ExtendedSystem, System

EDGE = 1e-6  # share of its range within which an estimate lies at its bound
MIN_COMMAND = 1e-4  # largest command over the limit of the system, below which the unit of the log is doubted
MAX_COMMAND = 1e4  # and above which it is doubted
SHAPES = (
    "frequency",
    "cycles",
    "pitch",
    "start",
    "duration",
)  # they choose where a cause acts; at their bounds the cause is still the same


def at_bound(problem: FitProblem, cause: Cause, fit: Fit) -> tuple[str, ...]:
    """Return the parameters of a cause whose estimates lie at a bound.

    Args:
        problem: Training windows.
        cause: The cause; an event has no bounds of its own and gives an empty result.
        fit: Fit with it. A bound that is the null value does not count, and neither does a loss that is gone.
    """
    if cause.effect == "event":
        return ()
    found, nulls = [], problem.null_values()
    for name in cause.free:
        j = problem.names.index(name)
        low, high, value = float(problem.low[j]), float(problem.high[j]), fit.values[name]
        near = EDGE * (high - low)
        if name.rpartition(".")[2] in SHAPES or abs(value - nulls[j]) <= near:
            continue
        if is_changed(cause) and value <= near and low == 0.0:
            continue
        if value <= low + near or value >= high - near:
            found.append(name)
    return tuple(found)


def doubts_of_estimates(problem: FitProblem, causes: Sequence[Cause], fit: Fit) -> tuple[str, ...]:
    """Return a sentence for every estimate of the causes that lies at its bound."""
    result = []
    for cause in causes:
        for name in at_bound(problem, cause, fit):
            result.append(
                f"{cause.name} fits best, but its {name.rpartition('.')[2]} stops at the bound "
                f"{fit.values[name]:.4g}. Another cause acts, or a unit of the log is wrong."
            )
    return tuple(result)


def doubts_of_friction(
    system: ExtendedSystem,
    causes: Sequence[Cause],
    fit: Fit,
    missing: Sequence[MissingTorque],
    inflation: float,
) -> tuple[str, ...]:
    """Return a sentence for every joint that its fitted friction would drive.

    Args:
        system: The system with every effect.
        causes: Selected causes.
        fit: Fit with them.
        missing: Missing load of each joint, with its speeds.
        inflation: Variance of the residuals, in noise variances.
    """
    result, rubbing = [], [c for c in causes if CAUSES[c.kind].family == "friction"]
    for joint in sorted({c.joint or 0 for c in rubbing}):
        fastest = float(np.quantile(np.abs(missing[joint].omega), 0.98))
        if fastest > 0.0 and pushes(friction_curve(system, fit, joint, fastest, inflation)):
            names = " and ".join(c.name for c in rubbing if (c.joint or 0) == joint)
            result.append(
                f"With {names}, the fitted friction of {system.joint_names[joint]} would drive the joint. No friction "
                "does this, so another cause acts."
            )
    return tuple(result)


def doubts_of_commands(windows: Windows, system: System) -> tuple[str, ...]:
    """Return a sentence for every command that is far too large or too small for the system."""
    result = []
    for k, channel in enumerate(system.commands):
        limit = max(abs(channel.low), abs(channel.high))
        top = max((float(np.abs(c.column(k)).max(initial=0.0)) for c in windows.commands), default=0.0)
        if not 0.0 < limit < math.inf or top == 0.0 or MIN_COMMAND * limit <= top <= MAX_COMMAND * limit:
            continue
        result.append(
            f'Command "{channel.name}" reaches {top:.3g} {channel.unit}, {top / limit:.2g} times the limit of '
            f"{limit:.4g} {channel.unit} of the system. Check its unit and scale first."
        )
    return tuple(result)


def doubts_of_bending(
    start: Baseline, causes: Sequence[Cause], lost: Finding | None, windows: Windows, fit: Fit
) -> tuple[str, ...]:
    """Return a sentence if lost commands, or a push together with another cause, leave more than noise.

    Args:
        start: The baseline.
        causes: Selected causes.
        lost: Lost commands; None where none are selected.
        windows: Training windows.
        fit: Fit with all of them.
    """
    pushes = sum(c.effect == "event" for c in causes)
    if lost is None and pushes in (0, len(causes)):
        return ()
    left = more_than_noise(fit, windows, start)
    if left is None:
        return ()
    what = "A pattern of lost commands" if lost is not None else "A push together with another cause"
    return (
        f"With {_listed(causes, lost)}, more than noise remains: {left}. {what} can imitate many other causes, so it "
        "is named only if nothing else remains.",
    )


def doubts_of_names(causes: Sequence[Cause], lost: Finding | None) -> tuple[str, ...]:
    """Return the sentence for causes that explain less, or hardly more, than a learned load.

    Args:
        causes: Selected causes.
        lost: Lost commands; None where none are selected.
    """
    names = _listed(causes, lost)
    return (
        f"A learned load, a smooth function of angle, speed and effort, explains the log nearly as well as {names}, or "
        "better.",
    )


def _listed(causes: Sequence[Cause], lost: Finding | None) -> str:
    return " and ".join([c.name for c in causes] + ([lost.name] if lost else []))

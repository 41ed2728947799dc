"""Signs that what is wrong lies beyond what the catalogue can say, so that no name in it can be trusted."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import CAUSES, Cause
from deepkoco.diagnose.diagnosis import Finding
from deepkoco.diagnose.residuals.friction_curve import friction_curve, pushes
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.systems import ExtendedSystem, System

EDGE = 1e-6  # share of its range within which an estimate lies at its bound
FAINT = 1e-4  # largest command per limit of the system, below which the log's unit is doubted
WILD = 1e4  # and above which it is
SHAPES = ("frequency", "cycles")  # they choose where a cause acts; at their bounds it is still the same one


def at_bound(problem: FitProblem, cause: Cause, fit: Fit) -> tuple[str, ...]:
    """Parameters of a cause that a fit has driven to a bound: the data want more of it than it can give.

    Args:
        problem: Training windows.
        cause: The cause; an event has no bounds of its own and never counts.
        fit: Fit with it. A bound that is the null value does not count.
    """
    if cause.effect == "event":
        return ()
    found, nulls = [], problem.null_values()
    for name in cause.free:
        j = problem.names.index(name)
        low, high, value = float(problem.low[j]), float(problem.high[j]), fit.values[name]
        near = EDGE * (high - low)
        if name.rsplit(".", 1)[1] in SHAPES or abs(value - nulls[j]) <= near:
            continue
        if value <= low + near or value >= high - near:
            found.append(name)
    return tuple(found)


def doubts_of_estimates(problem: FitProblem, causes: Sequence[Cause], fit: Fit) -> tuple[str, ...]:
    """One sentence for every estimate of named causes that lies at its bound."""
    result = []
    for cause in causes:
        for name in at_bound(problem, cause, fit):
            result.append(
                f"{cause.name} fits best of all, but its {name.rsplit('.', 1)[1]} stops at the bound of "
                f"{fit.values[name]:.4g}: the true cause is another, or the log and the system disagree in a unit."
            )
    return tuple(result)


def doubts_of_friction(
    system: ExtendedSystem,
    causes: Sequence[Cause],
    fit: Fit,
    missing: Sequence[MissingTorque],
    inflation: float,
) -> tuple[str, ...]:
    """One sentence for every joint whose friction, with the named causes, would drive it.

    Args:
        system: The system with every effect.
        causes: Named causes.
        fit: Fit with them.
        missing: Per joint, with its speeds.
        inflation: Variance of what the model leaves, in noise variances.
    """
    result, rubbing = [], [c for c in causes if CAUSES[c.kind].family == "friction"]
    for joint in sorted({c.joint or 0 for c in rubbing}):
        fastest = float(np.quantile(np.abs(missing[joint].omega), 0.98))
        if fastest > 0.0 and pushes(friction_curve(system, fit, joint, fastest, inflation)):
            names = " and ".join(c.name for c in rubbing if (c.joint or 0) == joint)
            result.append(
                f"With {names}, the friction of {system.joint_names[joint]} would push it on instead of holding it "
                "back; no friction does: something else acts like this."
            )
    return tuple(result)


def doubts_of_commands(windows: Windows, system: System) -> tuple[str, ...]:
    """One sentence for every command that is out of all proportion to what the system takes."""
    result = []
    for k, channel in enumerate(system.commands):
        limit = max(abs(channel.low), abs(channel.high))
        top = max((float(np.abs(c.column(k)).max(initial=0.0)) for c in windows.commands), default=0.0)
        if not 0.0 < limit < math.inf or top == 0.0 or FAINT * limit <= top <= WILD * limit:
            continue
        result.append(
            f'Command "{channel.name}" reaches {top:.3g} {channel.unit}, {top / limit:.2g} of the {limit:.4g} '
            f"{channel.unit} that the system takes: check its unit and scale before anything else."
        )
    return tuple(result)


def doubts_of_bending(
    start: Baseline, causes: Sequence[Cause], lost: Finding | None, windows: Windows, fit: Fit
) -> tuple[str, ...]:
    """A sentence for lost commands, and for a push beside other causes, that leave more than noise.

    Args:
        start: The baseline.
        causes: Causes that would be named.
        lost: Lost commands among them.
        windows: Training windows.
        fit: Fit with all of them.
    """
    pushes = sum(c.effect == "event" for c in causes)
    if lost is None and pushes in (0, len(causes)):
        return ()
    left = more_than_noise(fit, windows, start)
    if left is None:
        return ()
    what = "a pattern of lost commands bends" if lost is not None else "a push beside another cause bends"
    return (
        f"{_listed(causes, lost)} would leave more than noise: {left}; and {what} to much that it is not.",
    )


def doubts_of_names(causes: Sequence[Cause], lost: Finding | None) -> tuple[str, ...]:
    """A sentence for causes that explain hardly more than a learned load which stands for no mechanism, or less.

    Args:
        causes: Causes that would be named.
        lost: Lost commands among them.
    """
    names = _listed(causes, lost)
    return (f"A load that follows angle, speed and effort smoothly says nearly as much as {names}, or more.",)


def _listed(causes: Sequence[Cause], lost: Finding | None) -> str:
    return " and ".join([c.name for c in causes] + ([lost.name] if lost else []))

"""The friction of a joint over its speed, with the band that the data leave."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.layout import COLOURS, Layout
from deepkoco.identify.fit import Fit
from deepkoco.picture import Picture
from deepkoco.systems import ExtendedSystem, Motion

SPEEDS = 81
DRAWS = 400  # from the fit's normal approximation
SEED = 0  # of the draws: the same diagnosis gives the same figure


class FrictionCurve(NamedTuple):
    """Load against the motion over the speed of one joint, all (n,)."""

    speed: np.ndarray  # per second
    load: np.ndarray  # N m or N
    low: np.ndarray  # 95 % band
    high: np.ndarray


def friction_curve(
    system: ExtendedSystem, fit: Fit, joint: int, fastest: float, inflation: float
) -> FrictionCurve:
    """Friction of a joint under a fitted model.

    It is the part of the load on the joint that is odd in its speed, everything else at rest: the weight and what
    the motor does at zero speed cancel. Single parameters of friction laws are often not told apart (more viscous
    and less quadratic fit alike); the curve is what the data do say.

    Args:
        system: The system with every effect.
        fit: The model.
        joint: Which joint.
        fastest: Largest speed, per second.
        inflation: Variance of what the model leaves, in noise variances.
    """
    names = [p.name for p in system.parameters]
    acting = tuple({n.split(".")[0] for n in names if "." in n})
    model = ExtendedSystem(system.base, acting)
    free = [n for n in fit.free if n in names]
    index = [fit.free.index(n) for n in free]
    covariance = fit.covariance[np.ix_(index, index)] * inflation if free else np.zeros((0, 0))
    centre = np.array([fit.values[n] for n in free])
    rng = np.random.default_rng(SEED)
    values, vectors = np.linalg.eigh(covariance) if free else (np.zeros(0), np.zeros((0, 0)))
    root = vectors * np.sqrt(values.clip(0.0))
    draws = np.vstack([centre, centre + rng.standard_normal((DRAWS, len(free))) @ root.T])
    declared = {p.name: p for p in system.parameters}
    named = {n: torch.tensor(fit.values[n], dtype=torch.float64) for n in names}
    for k, n in enumerate(free):
        named[n] = torch.from_numpy(draws[:, k].clip(declared[n].low, declared[n].high))
    speed = torch.linspace(-fastest, fastest, SPEEDS, dtype=torch.float64)[:, None]
    load = _odd_load(model, named, joint, speed.expand(-1, len(draws)))
    low, high = np.quantile(load[:, 1:], [0.025, 0.975], axis=1)
    return FrictionCurve(speed[:, 0].numpy(), load[:, 0], low, high)


def _odd_load(model: ExtendedSystem, named: dict, joint: int, speed: torch.Tensor) -> np.ndarray:
    law = model.accelerations(named)
    zero = torch.zeros_like(speed)
    still = tuple(zero for _ in range(model.joints))
    efforts = tuple(zero for _ in model.commands)

    def acceleration(v: torch.Tensor, push: float) -> torch.Tensor:
        speeds = tuple(v if j == joint else zero for j in range(model.joints))
        loads = tuple(zero + push if j == joint else zero for j in range(model.joints))
        return law(Motion(still, speeds, efforts, loads, torch.zeros(1, dtype=torch.float64)))[joint]

    # A unit load changes the acceleration by the inverse inertia that the joint feels.
    lightness = acceleration(zero, 1.0) - acceleration(zero, 0.0)
    against = acceleration(-speed, 0.0) - acceleration(speed, 0.0)
    return (0.5 * against / lightness).numpy()


def friction_picture(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Friction before and after, where a cause of the friction family is named."""
    named = [c for c in diagnosis.causes if c.family == "friction"]
    if not named:
        return None
    known = catalogue(details.system.base)
    joint = known[named[0].name].joint or 0
    omega = np.abs(details.missing[joint].omega)
    fastest = float(np.quantile(omega, 0.98)) or 1.0
    curves = {
        "refitted": friction_curve(details.system, details.refit, joint, fastest, details.inflation),
        "with the named cause": friction_curve(
            details.system, details.final, joint, fastest, details.inflation
        ),
    }
    figure = Figure(figsize=(layout.width, 3.4))
    axis = figure.subplots()
    frame: dict[str, np.ndarray] = {}
    for (label, curve), colour in zip(curves.items(), (COLOURS["refit"], COLOURS["extended"]), strict=True):
        axis.fill_between(curve.speed, curve.low, curve.high, color=colour, alpha=0.2, lw=0)
        axis.plot(curve.speed, curve.load, color=colour, label=f"simulation {label}")
        short = label.split()[0].replace("with", "extended")
        frame |= {
            "speed": curve.speed,
            short: curve.load,
            f"{short}_low": curve.low,
            f"{short}_high": curve.high,
        }
    unit = details.system.state_units[details.system.joints + joint]
    of_joint = f" of joint {joint + 1}" if details.system.joints > 1 else ""
    axis.set_xlabel(f"speed{of_joint} [{unit}]")
    axis.set_ylabel(f"friction [{details.missing[joint].unit}]")
    figure.legend(loc="outside upper center", ncols=min(2, layout.entries))
    caption = (
        "The whole load that opposes the motion, at zero command, with 95 % bands. Different friction laws can draw "
        "nearly the same curve over the speeds that the log covers: believe the curve before the name of the law."
    )
    return Picture("friction_curve", "Friction over speed", caption, figure, pd.DataFrame(frame))

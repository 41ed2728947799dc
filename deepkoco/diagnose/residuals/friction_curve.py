"""Friction of a joint over its speed, with its 95 % band."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from deepkoco.fit.fit import Fit
from deepkoco.systems import ExtendedSystem, Motion

SPEEDS = 81
DRAWS = 400  # draws from the fit's normal approximation
SEED = 0  # of the draws, so that the same diagnosis gives the same curve
DRIVING_MARGIN = 2.0  # half widths of the 95 % band by which a driving curve must lie below 0
SLOWEST = 0.05  # share of the largest speed below which dry friction is smoothed


class FrictionCurve(NamedTuple):
    """Load against the motion, over the speed of one joint; all (n,)."""

    speed: np.ndarray  # per second
    load: np.ndarray  # N m or N
    low: np.ndarray  # 95 % band
    high: np.ndarray


def friction_curve(
    system: ExtendedSystem, fit: Fit, joint: int, fastest: float, inflation: float
) -> FrictionCurve:
    """Return the friction of a joint in a fitted model.

    Friction is the part of the load that is odd in the speed of the joint, with all other joints at rest. The weight
    and the motor's effort at zero speed cancel. To it comes what the effects add that is even in the speed and 0 at
    rest: friction that differs between the two directions. What the system itself has of this kind belongs to its
    inertia. Data often cannot distinguish single parameters of friction laws (more viscous and less quadratic
    friction fit alike), but they determine the curve.

    Args:
        system: The system with every effect.
        fit: The model.
        joint: Index of the joint.
        fastest: Largest speed, per second.
        inflation: Variance of the residuals, in noise variances.
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
    load = _friction(model, named, joint, speed.expand(-1, len(draws)))
    low, high = np.quantile(load[:, 1:], [0.025, 0.975], axis=1)
    return FrictionCurve(speed[:, 0].numpy(), load[:, 0], low, high)


def _friction(model: ExtendedSystem, named: dict, joint: int, speed: torch.Tensor) -> np.ndarray:
    odd, even = _odd_and_even_load(model, named, joint, speed)
    if not model.effects:
        return odd
    return odd + even - _odd_and_even_load(ExtendedSystem(model.base, ()), named, joint, speed)[1]


def _odd_and_even_load(
    model: ExtendedSystem, named: dict, joint: int, speed: torch.Tensor
) -> tuple[np.ndarray, np.ndarray]:
    """Both parts of the load against a motion forward, without the load at rest."""
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
    back, forth = acceleration(-speed, 0.0), acceleration(speed, 0.0)
    even = acceleration(zero, 0.0) - 0.5 * (back + forth)
    return (0.5 * (back - forth) / lightness).numpy(), (even / lightness).numpy()


def pushes(curve: FrictionCurve) -> bool:
    """Return whether the curve clearly drives the joint at some speed, which no friction does."""
    moving = np.abs(curve.speed) > SLOWEST * curve.speed.max()
    forward = curve.speed > 0.0
    against = np.where(forward, curve.load, -curve.load)
    beyond = np.where(forward, curve.high - curve.load, curve.load - curve.low)
    return bool((against + DRIVING_MARGIN * beyond < 0.0)[moving].any())

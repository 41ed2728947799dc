"""Slow feedback for systems that drift away from their rest state: a hovering quadrotor, an arm without gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import LinAlgError, solve_continuous_are
from torch import Tensor

from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import Motion, System

STEP = 1e-6  # step of the finite differences
DRIFT = 1e-3  # a real eigenvalue above -DRIFT counts as drift [1/s]
STRENGTH = 0.3  # share of the commands' range that costs as much as a displacement of 1 rad or m


@dataclass(frozen=True)
class Hold:
    """command = sequence - gain (measurement - place).

    Attributes:
        gain: (M, S) commands' units per unit of the state.
        place: (S,) state to hold.
    """

    gain: np.ndarray
    place: np.ndarray


def find_hold(
    system: System, place: np.ndarray, rest: np.ndarray, limits: np.ndarray, period: float
) -> Hold | None:
    """Return a linear-quadratic regulator about a state; None if the system does not drift away from it.

    Args:
        system: The nominal system.
        place: (S,) state to hold.
        rest: (M,) commands at this state.
        limits: (M, 2) limits of the commands.
        period: Time scale [s] that weighs speeds against displacements.

    Raises:
        DivergedError: The accelerations have no finite slope about the state.
    """
    a, b = linearised(system, place, rest)
    slope = np.concatenate([a, b], axis=1)
    if not np.isfinite(slope).all():
        row, column = np.argwhere(~np.isfinite(slope))[0]
        names = (*system.state_names, *(c.name for c in system.commands))
        raise DivergedError(
            f"the acceleration of {system.joint_names[row - system.joints]} is not finite beside the state to hold, "
            f"{STEP:g} away in {names[column]}; make accelerations() finite there"
        )
    roots = np.linalg.eigvals(a)
    if not bool(((roots.real > -DRIFT) & (np.abs(roots.imag) < 1e-6)).any()):
        return None
    joints = system.joints
    cost = np.diag(np.r_[np.ones(joints), np.full(joints, period**2 / 10.0)])
    effort = np.diag(1.0 / (STRENGTH * 0.5 * (limits[:, 1] - limits[:, 0])) ** 2)
    try:
        riccati = solve_continuous_are(a, b, cost, effort)
    except (LinAlgError, ValueError):
        return None
    gain = np.linalg.solve(effort, b.T @ riccati)
    return Hold(np.where(np.abs(gain) < 1e-9 * np.abs(gain).max(), 0.0, gain), place)


def linearised(system: System, state: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices A (S, S) and B (S, M) of the motion about a state, by central differences."""
    law, joints = system.accelerations(system.default_parameters()), system.joints
    point = np.concatenate([state, efforts])
    nudged = np.concatenate([point + STEP * np.eye(len(point)), point - STEP * np.eye(len(point))])
    x = torch.from_numpy(nudged)
    columns: tuple[Tensor, ...] = x.unbind(-1)
    motion = Motion(
        columns[:joints],
        columns[joints : 2 * joints],
        columns[2 * joints :],
        time=torch.zeros(len(x), dtype=torch.float64),
    )
    accelerations = torch.stack(torch.broadcast_tensors(*law(motion)), -1).numpy()
    rates = np.concatenate([nudged[:, joints : 2 * joints], accelerations], axis=1)
    slope = ((rates[: len(point)] - rates[len(point) :]) / (2.0 * STEP)).T
    return slope[:, : 2 * joints], slope[:, 2 * joints :]

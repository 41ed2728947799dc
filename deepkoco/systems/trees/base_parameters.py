r"""Which inertial parameters of a tree a motion can identify, and which only in combination: before any fit.

The loads that a motion needs are nearly linear in the parameters: d(load) = Y d(theta). With the columns of Y in prior
standard deviations and its rows in standard deviations of the load, Y^T Y is the information of the motion relative to
the prior. A combination of which the motion tells more than the prior has a singular value above 1. A QR factorisation
with pivoting picks one parameter for each of them; each of the others can only add to these.

Source: Gautier, Numerical calculation of the base inertial parameters of robots (1991), with priors as scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.linalg import qr, solve_triangular
from scipy.signal import savgol_filter

from deepkoco.systems.motion import Motion
from deepkoco.systems.trees.tree_system import TreeSystem

LOAD_NOISE = 0.02  # of the load that a sample shows, as a share of the joint's typical load
SMOOTHED = 0.1  # time over which angles are smoothed before they are differentiated [s]
STEP = 1e-3  # of a parameter [prior standard deviations]
FAINT = 0.01  # weight of a parameter in a combination that is not told [prior standard deviations per one]
MOST_SAMPLES = 2000


@dataclass(frozen=True)
class BaseParameters:
    """What a motion can tell.

    Attributes:
        names: All parameters that were asked about.
        singular_values: Information of each combination, as the square root of that of the prior; largest first.
        base: One parameter for each combination that the motion tells better than the prior.
        combinations: Base parameter -> the parameters whose changes look like its own -> change of it [its unit] that
            looks like a change of the other by 1 [its unit].
        unseen: Parameters that add less than the prior to every combination.
    """

    names: tuple[str, ...]
    singular_values: np.ndarray
    base: tuple[str, ...]
    combinations: dict[str, dict[str, float]]
    unseen: tuple[str, ...]

    @property
    def rank(self) -> int:
        """Number of combinations that the motion tells better than the prior."""
        return len(self.base)

    def __str__(self) -> str:
        lines = [f"{self.rank} combinations of {len(self.names)} parameters can be identified:"]
        for name in self.base:
            others = "".join(f" {c:+.3g} {other}" for other, c in self.combinations[name].items())
            lines.append(f"  {name}{others}")
        if self.unseen:
            lines.append(f"not shown by this motion: {', '.join(self.unseen)}")
        return "\n".join(lines)


def base_parameters(
    system: TreeSystem,
    t: np.ndarray,
    angles: np.ndarray,
    commands: np.ndarray,
    names: Sequence[str] | None = None,
    load_noise: float = LOAD_NOISE,
) -> BaseParameters:
    """Combinations of parameters that a log can identify.

    Args:
        system: The robot.
        t: (n,) stamps [s], increasing.
        angles: (n, J) coordinates [rad or m], unwrapped.
        commands: (n, M) commands in their units.
        names: Parameters; None takes all of the system.
        load_noise: Standard deviation of the load that one sample shows, as a share of the joint's typical load.

    Raises:
        ValueError: The log is shorter than 5 samples, or its arrays have different lengths.
    """
    chosen = tuple(p.name for p in system.parameters) if names is None else tuple(names)
    if len(t) < 5 or len(angles) != len(t) or len(commands) != len(t):
        raise ValueError(
            f"t has {len(t)} stamps, angles {len(angles)} and commands {len(commands)} rows; 5 or more are needed"
        )
    regressor = load_regressor(system, *smooth_motion(t, angles, commands), chosen)
    declared = [system.parameter(name) for name in chosen]
    sizes = np.array([p.prior_sd for p in declared])
    noise = load_noise * np.array(system.load_scales)
    matrix = (regressor * sizes / noise[:, None]).reshape(-1, len(chosen))
    values = np.linalg.svd(matrix, compute_uv=False)
    factors: Any = qr(matrix, mode="r", pivoting=True)
    triangle, pivots = np.asarray(factors[0]), [int(k) for k in factors[1]]
    size = min(triangle.shape)
    rank = int((np.abs(np.diag(triangle[:size, :size])) > 1.0).sum())
    weights = solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:])
    base = [chosen[k] for k in pivots[:rank]]
    combinations: dict[str, dict[str, float]] = {name: {} for name in base}
    unseen = []
    for column, k in enumerate(pivots[rank:]):
        own = weights[:, column]
        if np.linalg.norm(triangle[:, rank + column]) < 1.0:
            unseen.append(chosen[k])
            continue
        for row, name in enumerate(base):
            if abs(own[row]) > FAINT:
                ratio = sizes[pivots[row]] / sizes[k]
                combinations[name][chosen[k]] = float(own[row] * ratio)
    return BaseParameters(chosen, values, tuple(base), combinations, tuple(unseen))


def load_regressor(
    system: TreeSystem,
    angles: np.ndarray,
    speeds: np.ndarray,
    accelerations: np.ndarray,
    commands: np.ndarray,
    names: Sequence[str],
) -> np.ndarray:
    """Derivatives (n, J, P) of the outside load that a motion needs [N m or N] by parameters, at nominal values.

    Args:
        system: The robot.
        angles, speeds, accelerations: (n, J) motion [rad or m, per second, per squared second].
        commands: (n, M) in their units.
        names: P parameters.
    """
    values = {n: v.repeat(2 * len(names)) for n, v in system.default_parameters().items()}
    steps = np.array([STEP * system.parameter(name).prior_sd for name in names])
    for k, name in enumerate(names):
        values[name][2 * k] += steps[k]
        values[name][2 * k + 1] -= steps[k]

    def columns(rows: np.ndarray) -> tuple[torch.Tensor, ...]:
        return tuple(torch.from_numpy(np.ascontiguousarray(x))[:, None] for x in rows.T)

    shaped = tuple(
        system.shape_command(k, u, u[:, 0], values)
        for k, u in enumerate(columns(np.asarray(commands, dtype=float)))
    )
    motion = Motion(columns(angles), columns(speeds), shaped)
    loads = system.needed_loads(values)(motion, columns(accelerations))
    table = torch.stack(torch.broadcast_tensors(*loads), 1).numpy()  # (n, J, 2 P)
    return (table[..., 0::2] - table[..., 1::2]) / (2.0 * steps)


def smooth_motion(
    t: np.ndarray, angles: np.ndarray, commands: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Angles, speeds, accelerations and commands on even stamps."""
    step = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1], step)
    width = min(max(5, 2 * round(0.5 * SMOOTHED / step) + 1), 2 * ((len(even) - 1) // 2) + 1)
    path = np.column_stack([np.interp(even, t, column) for column in angles.T])
    q, v, a = (np.asarray(savgol_filter(path, width, 3, deriv=d, delta=step, axis=0)) for d in (0, 1, 2))
    held = np.asarray(commands, dtype=float)[np.searchsorted(t, even, side="right") - 1]
    pick = np.unique(np.linspace(0, len(even) - 1, min(len(even), MOST_SAMPLES)).astype(int))
    return q[pick], v[pick], a[pick], held[pick]

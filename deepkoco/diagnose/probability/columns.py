"""The simulation linearised at one point: a column for every coordinate, initial state and missing load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from deepkoco.diagnose.evidence.screening import LANES
from deepkoco.diagnose.probability.coordinates import Coordinate
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.tangent import Tangent


@dataclass(frozen=True)
class Columns:
    """Whitened derivatives at one point; n counts the measurements of a window.

    Attributes:
        changes: (W, n, q) by the coordinates.
        states: (W, n, S) by the initial states.
        residual: (W, n) measured minus simulated.
    """

    changes: np.ndarray
    states: np.ndarray
    residual: np.ndarray


def columns_at(problem: FitProblem, point: Fit, coordinates: Sequence[Coordinate]) -> Columns:
    """Linearise the simulation at a point.

    Args:
        problem: The windows.
        point: Parameters, initial states and encoder zeros of the point.
        coordinates: Changes whose columns are wanted. A change whose simulation diverges gets a column of zeros.
    """
    theta = np.array([point.values[n] for n in problem.names])
    tangent = Tangent.at(problem, theta, np.array([], dtype=int), point.state)
    lanes = [tangent.theta]
    for c in coordinates:
        lane = theta.copy()
        for name, value in c.place.items():
            lane[problem.names.index(name)] = value
        lane[problem.names.index(c.parameter)] += c.dose
        lanes.append(lane[None])
    theta_all = np.concatenate(lanes)
    states = torch.cat([tangent.state, point.state[None].repeat(len(coordinates), 1, 1)])
    parts = []
    for at in range(0, len(theta_all), LANES):
        chunk = slice(at, at + LANES)
        count = len(theta_all[chunk])
        parts.append(problem.predict(theta_all[chunk], states[chunk], point.nuisance[None].repeat(count, 1)))
    predicted = torch.cat(parts)
    windows, own = len(problem.windows), len(tangent)
    slopes = tangent.slopes(predicted[:own], problem)
    dose = torch.tensor([c.dose for c in coordinates], dtype=torch.float64)
    changes = problem.weighed((predicted[own:] - predicted[0]) / dose[:, None, None, None])
    changes = torch.where(torch.isfinite(changes).flatten(1).all(1)[:, None, None, None], changes, 0.0)
    residual = problem.weighed(problem.windows.value - predicted[0])
    return Columns(
        changes.reshape(len(coordinates), windows, -1).permute(1, 2, 0).numpy(),
        slopes.reshape(len(slopes), windows, -1).permute(1, 2, 0).numpy(),
        residual.reshape(windows, -1).numpy(),
    )


def zeros_of(problem: FitProblem) -> np.ndarray:
    """Return the whitened change (W, n, z) of the measurements by the unknown zeros of encoders, a set for each log."""
    none = torch.zeros(0, *problem.weight.shape, dtype=torch.float64)
    return problem.nuisance_slopes(none).flatten(2).permute(1, 2, 0).numpy()

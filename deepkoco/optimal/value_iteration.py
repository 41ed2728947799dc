"""Optimal control of a one-joint task by value iteration on a grid of angle and speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numba import njit
from torch import Tensor

from deepkoco.optimal.true_model import TrueModel, TrueModelError


@dataclass(frozen=True)
class ValueTable:
    """Cost to go V(theta, omega) on a grid, linear between its points and periodic in the angle.

    Attributes:
        values: (angles, speeds).
        speed_limit: The speeds are evenly spaced in +-speed_limit [rad/s].
        sweeps: Of the iteration that made it.
        change: Largest change of a value in the last of them.
    """

    values: np.ndarray
    speed_limit: float
    sweeps: int
    change: float

    def at(self, state: Tensor) -> Tensor:
        """Cost to go (...) of states (..., 2)."""
        flat = state.reshape(-1, 2).numpy()
        angles, speeds = self.values.shape
        rows, columns = _grid_place(flat, angles, speeds, self.speed_limit)
        return torch.from_numpy(_interpolate(self.values, rows, columns)).reshape(state.shape[:-1])


class ValueIteration:
    r"""V_0 = 0, V_{k+1}(x) = min_a c(x, a) + V_k(f(x, a)): the optimal cost of k + 1 steps.

    Where a task can be held at no cost, V_k converges without a discount. The controller is the greedy one,
    over actions that are finer than those of the iteration.

    Args:
        model: A one-joint task.
        angles: Points of the grid over a turn.
        speeds: Points of the grid over the speeds the task allows.
        actions: Actions between the limits in the iteration.

    Raises:
        TrueModelError: The state is not (angle, speed), or the task has no speed limit.

    Source: Bertsekas, Dynamic Programming and Optimal Control, vol. 1, ch. 1.
    """

    def __init__(self, model: TrueModel, angles: int = 301, speeds: int = 301, actions: int = 31) -> None:
        limit = model.task.speed_limit
        if model.state_size != 2 or model.angles != 1 or not math.isfinite(limit):
            raise TrueModelError("value iteration on a grid is for one joint with a speed limit")
        self.model, self.speed_limit = model, limit
        turn = 2 * math.pi * torch.arange(angles, dtype=torch.float64) / angles
        speed = torch.linspace(-limit, limit, speeds, dtype=torch.float64)
        self._points = torch.stack(torch.meshgrid(turn, speed, indexing="ij"), -1).reshape(-1, 2)
        self._shape, self._actions = (angles, speeds), _action_grid(model, actions)

    def solve(self, sweeps: int, tolerance: float = 1e-3) -> ValueTable:
        """Iterate.

        Args:
            sweeps: At most so many: the steps of an episode.
            tolerance: Stop where no value changes by more in a sweep.
        """
        count = len(self._points)
        rows = np.empty((len(self._actions), count), np.float32)
        columns, costs = np.empty_like(rows), np.empty_like(rows)
        for i, action in enumerate(self._actions):
            given = action.expand(count, 1)
            costs[i] = self.model.cost(self._points, given).numpy()
            following = self.model.step(self._points, given).numpy()
            rows[i], columns[i] = _grid_place(following, *self._shape, self.speed_limit)
        values = np.zeros(self._shape)
        change, sweep = math.inf, 0
        while sweep < sweeps and change > tolerance:
            after = _sweep(values, rows, columns, costs)
            change = float(np.abs(after - values).max())
            values, sweep = after, sweep + 1
        return ValueTable(values, self.speed_limit, sweep, change)

    def controller(self, table: ValueTable, actions: int = 101):
        """Greedy feedback on a table.

        Args:
            table: Made by `solve`.
            actions: Actions between the limits that are tried at every step.

        Returns:
            Gives actions (B, 1) for states (B, 2) and a step number.
        """
        tried = _action_grid(self.model, actions)

        def control(state: Tensor, step: int) -> Tensor:
            batch = state[:, None].expand(-1, actions, -1)
            given = tried[None].expand(len(state), -1, -1)
            total = self.model.cost(batch, given) + table.at(self.model.step(batch, given).contiguous())
            return tried[total.argmin(1)]

        return control


def _action_grid(model: TrueModel, count: int) -> Tensor:
    """(count, 1), from limit to limit."""
    return torch.linspace(float(model.low[0]), float(model.high[0]), count, dtype=torch.float64)[:, None]


def _grid_place(states: np.ndarray, angles: int, speeds: int, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of states (n, 2) as fractions."""
    turn = 2 * math.pi
    rows = np.remainder(states[:, 0], turn) * (angles / turn)
    columns = (np.clip(states[:, 1], -limit, limit) + limit) * ((speeds - 1) / (2 * limit))
    return rows, columns


@njit(cache=True)
def _between(values, row, column):
    angles, speeds = values.shape
    i, j = int(row), min(int(column), speeds - 2)
    s, t = row - i, column - j
    # Rounding may put a row just below a full turn on it. Comparisons, for a modulo takes most of the time.
    i = i - angles if i >= angles else i
    k = i + 1 if i + 1 < angles else 0
    near = values[i, j] * (1 - t) + values[i, j + 1] * t
    return near * (1 - s) + (values[k, j] * (1 - t) + values[k, j + 1] * t) * s


@njit(cache=True)
def _interpolate(values, rows, columns):
    result = np.empty(rows.shape[0])
    for n in range(rows.shape[0]):
        result[n] = _between(values, rows[n], columns[n])
    return result


@njit(cache=True)
def _sweep(values, rows, columns, costs):
    after = np.full(values.size, np.inf)
    for a in range(rows.shape[0]):
        for n in range(rows.shape[1]):
            total = costs[a, n] + _between(values, rows[a, n], columns[a, n])
            after[n] = min(after[n], total)
    return after.reshape(values.shape)

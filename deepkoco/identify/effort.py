"""What the actuator delivers over each integration step, from zero-order-hold commands."""

from __future__ import annotations

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from deepkoco.identify.windows import CommandSeries, Windows
from deepkoco.systems import System

CELL = 1e-3  # grid on which commands are averaged and filtered [s]


def step_efforts(
    system: System, windows: Windows, parameters: dict[str, Tensor], lanes: int
) -> tuple[Tensor, Tensor]:
    """Effort at the start and the slope of the effort over every integration step of every window.

    Memoryless effects act on the command's values, then the actuator's lag, then the delays. A delayed
    command jumps inside a step; the effort a + b s over the step is chosen so that its integral and its
    double integral over the step equal those of the true effort, so that speed and angle after the step
    are right to the order of the integrator and depend smoothly on the delay. A sensing delay acts as one
    more delay of the command: the window's state is then the state that the sensor shows.

    Args:
        system: Gives ``actuate`` and ``timing``.
        windows: W windows of n steps.
        parameters: Named values, each (L,) or scalar.
        lanes: L.

    Returns:
        a (L, W, n) in the command's unit and b (L, W, n) per second.
    """
    timing = system.timing(parameters)
    delay = (timing.actuation_delay + timing.sensing_delay).expand(lanes).numpy()
    lag = timing.lag.expand(lanes).numpy()
    start = torch.empty(lanes, len(windows), windows.steps, dtype=torch.float64)
    slope = torch.empty_like(start)
    for index, command in enumerate(windows.commands):
        own = np.flatnonzero(windows.log == index)
        if len(own) == 0:
            continue
        value = torch.from_numpy(command.value)[:, None]
        shaped = system.actuate(value, parameters).expand(len(value), lanes).numpy().T  # (L, n)
        edges, first = windows.t0[own], windows.t0[own].min() - delay.max() - 2.0 * CELL
        first = max(first, command.t[0] - delay.max() - 2.0 * CELL) if not lag.any() else command.t[0] - 1.0
        last = edges.max() + windows.length
        # Lanes with the same efforts share one series, lanes with the same series and delay one result.
        key = np.column_stack([shaped[:, _probe(command)], lag])
        _, distinct, member = np.unique(key, axis=0, return_index=True, return_inverse=True)
        series = _Integrals(command, shaped[distinct], lag[distinct], first, last)
        _, distinct, group = np.unique(
            np.column_stack([member.ravel(), delay]), axis=0, return_index=True, return_inverse=True
        )
        a, b = series.steps(member.ravel()[distinct], delay[distinct], edges, windows.step, windows.steps)
        where = torch.as_tensor(own)
        lane = torch.as_tensor(group.ravel())
        start[:, where] = torch.from_numpy(a)[lane]
        slope[:, where] = torch.from_numpy(b)[lane]
    return start, slope


def _probe(command: CommandSeries) -> np.ndarray:
    """A few samples that tell two memoryless effects apart: spread over the sorted command values."""
    order = np.argsort(command.value, kind="stable")
    return order[np.unique(np.linspace(0, len(order) - 1, 65).astype(int))]


class _Integrals:
    """First and second integral over time of efforts (U, n), averaged on a regular grid."""

    def __init__(
        self, command: CommandSeries, effort: np.ndarray, lag: np.ndarray, first: float, last: float
    ) -> None:
        cells = int(np.ceil((last - first) / CELL)) + 2
        grid = first + CELL * np.arange(cells + 1)
        area = np.zeros_like(effort)
        np.cumsum(effort[:, :-1] * np.diff(command.t), axis=1, out=area[:, 1:])
        held = np.clip(np.searchsorted(command.t, grid, side="right") - 1, 0, None)
        integral = area[:, held] + effort[:, held] * (grid - command.t[held])
        self.first = first
        self.mean = np.diff(integral, axis=1) / CELL
        for row in np.flatnonzero(lag > 0):
            self.mean[row] = _lagged(self.mean[row], lag[row])
        zero = np.zeros((len(effort), 1))
        self.once = np.concatenate([zero, np.cumsum(self.mean, axis=1) * CELL], axis=1)
        twice = np.cumsum(self.once[:, :-1] * CELL + self.mean * (0.5 * CELL**2), axis=1)
        self.twice = np.concatenate([zero, twice], axis=1)

    def steps(
        self, row: np.ndarray, delay: np.ndarray, t0: np.ndarray, step: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """a, b (R, W, n) for rows of this series, each with a delay [s]."""
        node = t0[:, None] + step * np.arange(steps + 1)
        at = (node[None] - delay[:, None, None] - self.first) / CELL
        cell = np.clip(at.astype(int), 0, self.mean.shape[1] - 1)
        inside = (at - cell) * CELL
        lane = row[:, None, None]
        mean, before = self.mean[lane, cell], self.once[lane, cell]
        once = before + mean * inside
        twice = self.twice[lane, cell] + inside * (before + 0.5 * mean * inside)
        first = np.diff(once, axis=2)
        second = np.diff(twice, axis=2) - step * once[:, :, :-1]
        b = 12.0 * (0.5 * step * first - second) / step**3
        return first / step - 0.5 * step * b, b


def _lagged(mean: np.ndarray, time_constant: float) -> np.ndarray:
    """Cell averages of a first-order lag driven by cell averages, exact for inputs constant in a cell."""
    alpha = np.exp(-CELL / time_constant)
    # State of the lag at the start of each cell: z[i + 1] = alpha z[i] + (1 - alpha) u[i].
    after, _ = lfilter([1.0 - alpha], [1.0, -alpha], mean, zi=[alpha * mean[0]])
    before = np.concatenate([[mean[0]], after[:-1]])
    return mean - (mean - before) * (time_constant / CELL) * (1.0 - alpha)

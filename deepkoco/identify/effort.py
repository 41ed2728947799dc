"""What the actuator delivers over each integration step, from zero-order-hold commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from deepkoco.identify.windows import CommandSeries, Windows
from deepkoco.systems import System

CELL = 2.5e-4  # grid on which commands are averaged before a lag [s]


def step_efforts(
    system: System, windows: Windows, parameters: Mapping[str, Tensor], lanes: int
) -> tuple[Tensor, Tensor]:
    """As :func:`command_efforts` for a system of one command, lanes first: (L, W, n)."""
    start, slope = command_efforts(system, windows, parameters, lanes, 0)
    return start.permute(2, 1, 0), slope.permute(2, 1, 0)


def command_efforts(
    system: System, windows: Windows, parameters: Mapping[str, Tensor], lanes: int, index: int
) -> tuple[Tensor, Tensor]:
    """Effort of one command at the start, and its slope, over every integration step of every window.

    Effects of the actuator act on the log of the command, then its lags, then the delays. A delayed
    command jumps inside a step; the effort a + b s over the step is chosen so that its integral and its
    double integral over the step equal those of the true effort, so that speed and angle after the step
    are right to the order of the integrator and depend smoothly on the delay. A sensing delay acts as one
    more delay of the command: the window's state is then the state that the sensor shows. Where the clock
    of the measurements runs faster than that of the commands, the delay grows in proportion to the time
    since the log's first command; within a window it is held.

    Args:
        system: Gives ``shape_command`` and ``command_timing``.
        windows: W windows of n steps.
        parameters: Named values, each (L,) or scalar.
        lanes: L.
        index: Which command.

    Returns:
        a (n, W, L) in the command's unit and b (n, W, L) per second.
    """
    timing = system.command_timing(index, parameters)
    delay, skew = timing.delay.expand(lanes).numpy(), timing.skew.expand(lanes).numpy()
    lags = [lag.expand(lanes).numpy() for lag in timing.lag]
    slow = any(lag.any() for lag in lags)
    start = torch.empty(windows.steps, len(windows), lanes, dtype=torch.float64)
    slope = torch.empty_like(start)
    for number, command in enumerate(windows.commands):
        own = np.flatnonzero(windows.log == number)
        if len(own) == 0:
            continue
        given = torch.from_numpy(np.ascontiguousarray(command.column(index)))[:, None]
        shaped = system.shape_command(index, given, torch.from_numpy(command.t), parameters)
        shaped = shaped.expand(len(given), lanes).numpy().T  # (L, n)
        edges = windows.t0[own]
        # Lanes with the same efforts share one series, lanes with the same series and delay one result.
        key = np.column_stack([shaped[:, _probe(command, index)], *lags])
        _, distinct, member = np.unique(key, axis=0, return_index=True, return_inverse=True)
        if slow:
            early = np.abs(skew).max() * (edges.max() + windows.length - command.t[0])
            last = edges.max() + windows.length + early
            series = _Averaged(command, shaped[distinct], [lag[distinct] for lag in lags], last)
        else:
            series = _Held(command, shaped[distinct])
        late = np.column_stack([member.ravel(), delay, skew])
        _, distinct, group = np.unique(late, axis=0, return_index=True, return_inverse=True)
        a, b = series.steps(
            member.ravel()[distinct],
            delay[distinct, None] + skew[distinct, None] * (edges + 0.5 * windows.length - command.t[0]),
            edges,
            windows.step,
            windows.steps,
        )
        where, lane = torch.as_tensor(own), torch.as_tensor(group.ravel())
        start[:, where] = torch.from_numpy(a).permute(2, 1, 0)[..., lane]
        slope[:, where] = torch.from_numpy(b).permute(2, 1, 0)[..., lane]
    return start, slope


def _probe(command: CommandSeries, index: int) -> np.ndarray:
    """A few samples that tell two effects apart: spread over the sorted command values and over time."""
    order = np.argsort(command.column(index), kind="stable")
    spread = np.linspace(0, len(order) - 1, 65).astype(int)
    return np.unique(np.concatenate([order[spread], spread]))


class _Held:
    """First and second integral over time of held efforts (U, n), exact.

    A grid would blur each jump by an amount that depends on where the jump falls in its cell, so that the cost
    would quiver with the delay: on a plant that is unstable enough to hide a small delay from a fit.
    """

    def __init__(self, command: CommandSeries, effort: np.ndarray) -> None:
        self.t, self.effort = command.t, effort
        gap = np.diff(command.t)
        once, twice = np.zeros_like(effort), np.zeros_like(effort)
        np.cumsum(effort[:, :-1] * gap, axis=1, out=once[:, 1:])
        np.cumsum(once[:, :-1] * gap + 0.5 * effort[:, :-1] * gap**2, axis=1, out=twice[:, 1:])
        self.once, self.twice = once, twice

    def steps(
        self, row: np.ndarray, delay: np.ndarray, t0: np.ndarray, step: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """a, b (R, W, n) for rows of this series, each with a delay (R, W) [s]."""
        at = _nodes(delay, t0, step, steps)
        # Before the log the first command holds: its piece reaches back without end.
        piece = np.clip(np.searchsorted(self.t, at, side="right") - 1, 0, None)
        lane, inside = row[:, None, None], at - self.t[piece]
        effort, before = self.effort[lane, piece], self.once[lane, piece]
        once = before + effort * inside
        twice = self.twice[lane, piece] + inside * (before + 0.5 * effort * inside)
        return _line(once, twice, step)


class _Averaged:
    """The same behind first-order lags, from averages over the cells of a regular grid."""

    def __init__(
        self, command: CommandSeries, effort: np.ndarray, lags: Sequence[np.ndarray], last: float
    ) -> None:
        self.first = command.t[0] - 1.0
        cells = int(np.ceil((last - self.first) / CELL)) + 2
        grid = self.first + CELL * np.arange(cells + 1)
        area = np.zeros_like(effort)
        np.cumsum(effort[:, :-1] * np.diff(command.t), axis=1, out=area[:, 1:])
        held = np.clip(np.searchsorted(command.t, grid, side="right") - 1, 0, None)
        integral = area[:, held] + effort[:, held] * (grid - command.t[held])
        self.mean = np.diff(integral, axis=1) / CELL
        for lag in lags:
            for row in np.flatnonzero(lag > 0):
                self.mean[row] = _lagged(self.mean[row], lag[row], CELL)
        zero = np.zeros((len(effort), 1))
        self.once = np.concatenate([zero, np.cumsum(self.mean, axis=1) * CELL], axis=1)
        twice = np.cumsum(self.once[:, :-1] * CELL + self.mean * (0.5 * CELL**2), axis=1)
        self.twice = np.concatenate([zero, twice], axis=1)

    def steps(
        self, row: np.ndarray, delay: np.ndarray, t0: np.ndarray, step: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """a, b (R, W, n) for rows of this series, each with a delay (R, W) [s]."""
        at = (_nodes(delay, t0, step, steps) - self.first) / CELL
        cell = np.clip(at.astype(int), 0, self.mean.shape[1] - 1)
        inside = (at - cell) * CELL
        lane = row[:, None, None]
        mean, before = self.mean[lane, cell], self.once[lane, cell]
        once = before + mean * inside
        twice = self.twice[lane, cell] + inside * (before + 0.5 * mean * inside)
        return _line(once, twice, step)


def _nodes(delay: np.ndarray, t0: np.ndarray, step: float, steps: int) -> np.ndarray:
    """(R, W, n + 1) when the commands were sent that act at the nodes [s]."""
    return (t0[:, None] + step * np.arange(steps + 1))[None] - delay[..., None]


def _line(once: np.ndarray, twice: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """The line over each step that has the same integral and double integral, from both at the nodes."""
    first = np.diff(once, axis=2)
    second = np.diff(twice, axis=2) - step * once[:, :, :-1]
    b = 12.0 * (0.5 * step * first - second) / step**3
    return first / step - 0.5 * step * b, b


def _lagged(mean: np.ndarray, time_constant: float, cell: float) -> np.ndarray:
    """Cell averages of a first-order lag driven by cell averages, exact for inputs constant in a cell."""
    alpha = np.exp(-cell / time_constant)
    # State of the lag at the start of each cell: z[i + 1] = alpha z[i] + (1 - alpha) u[i].
    after, _ = lfilter([1.0 - alpha], [1.0, -alpha], mean, zi=[alpha * mean[0]])
    before = np.concatenate([[mean[0]], after[:-1]])
    return mean - (mean - before) * (time_constant / cell) * (1.0 - alpha)

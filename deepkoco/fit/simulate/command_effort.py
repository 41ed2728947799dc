"""Compute the effort of the actuators over each integration step from zero-order-hold commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from scipy.linalg import solve_banded
from torch import Tensor

from deepkoco.fit.data.per_log_differences import of_log
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.systems import System
from deepkoco.systems.motion import CommandTiming


class TooManyLagsError(ValueError):
    """A command has more than two first-order lags in series."""


def step_efforts(
    system: System, windows: Windows, parameters: Mapping[str, Tensor], lanes: int
) -> tuple[Tensor, Tensor]:
    """As :func:`command_efforts` for a system with one command, but in the order (L, W, n)."""
    start, slope = command_efforts(system, windows, parameters, lanes, 0)
    return start.permute(2, 1, 0), slope.permute(2, 1, 0)


def command_efforts(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    lanes: int,
    index: int,
    differ: Mapping[str, Tensor] | None = None,
) -> tuple[Tensor, Tensor]:
    """Compute start value a and slope b of one command's effort over every integration step of every window.

    The logged command passes the effects of the actuator, then its lags, then the delays. A delayed command can jump
    inside a step. The line a + b s over the step has the same integral and double integral as the true effort. Speed
    and angle after the step then have the order of the integrator, and they depend smoothly on the delay. A sensing
    delay is added to the delay of the command; the window's state is then the state that the sensor shows. If the
    clock of the measurements is faster than that of the commands, the delay grows with the time since the log's
    first command. Within a window it is constant.

    Args:
        system: Gives ``shape_command`` and ``command_timing``.
        windows: W windows of n steps.
        parameters: Named values, each (L,) or scalar.
        lanes: Number L of lanes.
        index: Index of the command.
        differ: Parameter -> (K, 1) or (K, L) differences in each of K logs.

    Returns:
        a (n, W, L) in the command's unit and b (n, W, L) per second.

    Raises:
        TooManyLagsError: More than two lags in series have a time constant above 0.
    """
    start = torch.empty(windows.steps, len(windows), lanes, dtype=torch.float64)
    slope = torch.empty_like(start)
    for number, command in enumerate(windows.commands):
        own = np.flatnonzero(windows.log == number)
        if len(own) == 0:
            continue
        own_values = of_log(parameters, differ or {}, number)
        timing = system.command_timing(index, own_values)
        given = torch.from_numpy(np.ascontiguousarray(command.column(index)))[:, None]
        shaped = system.shape_command(index, given, torch.from_numpy(command.t), own_values)
        # Where nothing differs between lanes, one lane is computed for all.
        alike = shaped.shape[-1] == 1 and all(
            x.numel() == 1 for x in (timing.delay, timing.skew, *timing.lag)
        )
        computed = 1 if alike else lanes
        delay, skew, lags = _times(system, index, timing, computed)
        shaped = shaped.expand(len(given), computed).numpy().T  # (L, n)
        edges = windows.t0[own]
        distinct, member = np.zeros(1, dtype=int), np.zeros(computed, dtype=int)
        if computed > 1:
            # Lanes with the same efforts share one series. Those with the same series and delay share one result.
            key = np.column_stack([shaped[:, _probe(command, index)], *lags])
            distinct, member = _distinct(key)
        series = _HeldEfforts(command, shaped[distinct], [lag[distinct] for lag in lags])
        distinct, group = np.zeros(1, dtype=int), member
        if computed > 1:
            distinct, group = _distinct(np.column_stack([member, delay, skew]))
        a, b = series.steps(
            member[distinct],
            delay[distinct, None] + skew[distinct, None] * (edges + 0.5 * windows.length - command.t[0]),
            edges,
            windows.step,
            windows.steps,
        )
        where, lane = torch.as_tensor(own), torch.as_tensor(group)
        start[:, where] = torch.from_numpy(a).permute(2, 1, 0)[..., lane]
        slope[:, where] = torch.from_numpy(b).permute(2, 1, 0)[..., lane]
    return start, slope


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the first of each distinct row, and for each row the number of its own."""
    _, first, member = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, member.ravel()


def _times(
    system: System, index: int, timing: CommandTiming, lanes: int
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """(L,) delay [s], skew of the clocks [1], and time constant of each lag [s]."""
    delay, skew = timing.delay.expand(lanes).numpy(), timing.skew.expand(lanes).numpy()
    lags = [lag.expand(lanes).numpy() for lag in timing.lag]
    most = np.count_nonzero(np.stack(lags) > 0.0, axis=0).max() if len(lags) > 2 else 0
    if most > 2:
        raise TooManyLagsError(
            f'{system.name}: the command "{system.commands[index].name}" has {most} lags in series; at most two can be '
            "fitted: set the time constant of one to 0 s"
        )
    return delay, skew, lags


def _probe(command: CommandSeries, index: int) -> np.ndarray:
    """Samples at which to compare efforts of lanes: spread over the sorted command values and over time."""
    order = np.argsort(command.column(index), kind="stable")
    spread = np.linspace(0, len(order) - 1, 65).astype(int)
    return np.unique(np.concatenate([order[spread], spread]))


class _HeldEfforts:
    """Exact first and second time integrals of held efforts (U, n) behind first-order lags.

    On a grid, the error of a jump would depend on its position in its cell, and the cost would oscillate with the
    delay. On an unstable plant, these oscillations can be larger than the effect of a small delay.

    For a lag T y' + y = u, the integral of y is that of u minus T (y - y_0). Besides u, only the values y at the
    requested times are therefore needed.

    Args:
        command: Stamps of the log.
        effort: (U, n) efforts, each held from its stamp to the next.
        lags: (U,) time constants [s] of one or two lags in series; 0 for none. At the start of the log the lags are in
            steady state.
    """

    def __init__(self, command: CommandSeries, effort: np.ndarray, lags: Sequence[np.ndarray]) -> None:
        self.t, self.effort = command.t, effort
        gap = np.diff(command.t)
        once, twice = np.zeros_like(effort), np.zeros_like(effort)
        np.cumsum(effort[:, :-1] * gap, axis=1, out=once[:, 1:])
        np.cumsum(once[:, :-1] * gap + 0.5 * effort[:, :-1] * gap**2, axis=1, out=twice[:, 1:])
        self.once, self.twice = once, twice
        # Lags commute. With the shorter one first, the exponentials below do not overflow.
        chain = np.sort(np.array([*lags, *[np.zeros(len(effort))] * (2 - len(lags))]), axis=0)
        self.short, self.long = chain[-2], chain[-1]
        # Deviation of the output of each lag from the effort, at the stamps.
        self.first, self.second = np.zeros_like(effort), np.zeros_like(effort)
        jump = -np.diff(effort, axis=1)
        lagged = np.flatnonzero(self.long > 0.0)
        for short, long in np.unique(np.column_stack([self.short, self.long])[lagged], axis=0):
            rows = np.flatnonzero((self.short == short) & (self.long == long))
            own = jump[rows].T
            if short > 0.0:
                self.first[rows] = _lag_deviation(np.exp(-gap / short), own).T
            if long > 0.0:
                passed = (
                    _long_lag_response(gap, short, long)[:, None] * self.first[rows, :-1].T
                    if short > 0.0
                    else 0.0
                )
                self.second[rows] = _lag_deviation(np.exp(-gap / long), own + passed).T

    def steps(
        self, row: np.ndarray, delay: np.ndarray, t0: np.ndarray, step: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Start values a and slopes b (R, W, n) of the efforts in these rows, each with a delay (R, W) [s]."""
        at = _nodes(delay, t0, step, steps)
        # The first command is assumed to hold at all times before the log.
        piece = np.clip(np.searchsorted(self.t, at, side="right") - 1, 0, None)
        lane, inside = row[:, None, None], at - self.t[piece]
        effort, before = self.effort[lane, piece], self.once[lane, piece]
        once = before + effort * inside
        twice = self.twice[lane, piece] + inside * (before + 0.5 * effort * inside)
        slow = np.flatnonzero(self.long[row] > 0.0)
        if len(slow):
            own, since = row[slow], np.clip(inside[slow], 0.0, None)
            past, lane, piece = at[slow] - self.t[0], lane[slow], piece[slow]
            short, long = self.short[own][:, None, None], self.long[own][:, None, None]
            start = self.effort[own, 0][:, None, None]
            one = self.first[lane, piece] * _decay(since, short)
            two = self.second[lane, piece] * _decay(since, long)
            two = two + self.first[lane, piece] * _long_lag_response(since, short, long)
            for constant, left in ((short, one), (long, two)):
                shown = np.where(constant > 0.0, effort[slow] + left - start, 0.0)
                once[slow] -= constant * shown
                twice[slow] -= constant * (once[slow] - start * past)
        return _line(once, twice, step)


def _lag_deviation(keep: np.ndarray, jump: np.ndarray) -> np.ndarray:
    """(n + 1, U) output minus input of a lag: x[0] = 0, x[i + 1] = keep[i] x[i] + jump[i]."""
    band = np.ones((2, len(keep) + 1))
    band[1, :-1], band[1, -1] = -keep, 0.0
    given = np.concatenate([np.zeros((1, jump.shape[1])), jump])
    # A lane that is not finite must not raise an error for the others.
    return solve_banded((1, 0), band, given, check_finite=False)


def _decay(since: np.ndarray, constant: np.ndarray) -> np.ndarray:
    return np.where(constant > 0.0, np.exp(-since / np.where(constant > 0.0, constant, 1.0)), 0.0)


def _long_lag_response(since: np.ndarray, short: np.ndarray | float, long: np.ndarray | float) -> np.ndarray:
    """Response of the longer lag after a time to a unit deviation of the shorter lag from its input."""
    acts = np.asarray(short) > 0.0
    quick, slow = np.where(acts, short, 1.0), np.where(acts, long, 1.0)
    apart = since * (1.0 / quick - 1.0 / slow)  # never below 0
    # -expm1(-x) / x goes to 1 as x goes to 0, so equal lags need no special case.
    ratio = np.where(apart > 1e-12, -np.expm1(-apart) / np.where(apart > 1e-12, apart, 1.0), 1.0)
    return np.where(acts, np.exp(-since / slow) * since / slow * ratio, 0.0)


def _nodes(delay: np.ndarray, t0: np.ndarray, step: float, steps: int) -> np.ndarray:
    """(R, W, n + 1) times [s] at which the commands that act at the nodes were sent."""
    return (t0[:, None] + step * np.arange(steps + 1))[None] - delay[..., None]


def _line(once: np.ndarray, twice: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Line over each step with the given integral and double integral, which are given at the nodes."""
    first = np.diff(once, axis=2)
    second = np.diff(twice, axis=2) - step * once[:, :, :-1]
    b = 12.0 * (0.5 * step * first - second) / step**3
    return first / step - 0.5 * step * b, b

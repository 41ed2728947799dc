"""Compute the effort of the actuators over each integration step from zero-order-hold commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.per_log_differences import of_log
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.simulate.held_efforts import HeldEfforts
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
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
    if len(windows.commands) > 1 and not differ and all(x.numel() == 1 for x in parameters.values()):
        parts = _of_one_lane(system, windows, parameters, index)
    for number, command in enumerate(windows.commands if not parts else ()):
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
        series = HeldEfforts(command, shaped[distinct], [lag[distinct] for lag in lags])
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
        parts.append((own, group, a, b))
    start, slope = (
        _in_lanes([(own, group, each[k]) for own, group, *each in parts], len(windows), windows.steps, lanes)
        for k in range(2)
    )
    return start, slope


def _of_one_lane(
    system: System, windows: Windows, parameters: Mapping[str, Tensor], index: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return windows, lanes and lines of each log, where all logs have the same parameters and there is one lane.

    Logs that share their stamps pass the actuator together: a search for lost commands makes a hundred of one log, and
    so does one for noise of the commands.
    """
    timing = system.command_timing(index, parameters)
    delay, skew, lags = _times(system, index, timing, 1)
    alike: dict[int, list[int]] = {}
    for number in np.unique(windows.log).tolist():
        alike.setdefault(id(windows.commands[number].t), []).append(number)
    parts, one = [], np.zeros(1, dtype=int)
    of_logs = np.argsort(windows.log, kind="stable")
    starts = np.searchsorted(windows.log[of_logs], np.arange(len(windows.commands) + 1))
    for numbers in alike.values():
        command = windows.commands[numbers[0]]
        given = torch.from_numpy(np.stack([windows.commands[n].column(index) for n in numbers], axis=1))
        shaped = system.shape_command(index, given, torch.from_numpy(command.t), parameters)
        effort = np.ascontiguousarray(shaped.expand(len(given), len(numbers)).numpy().T)
        series = HeldEfforts(command, effort, [lag.repeat(len(numbers)) for lag in lags])
        together: dict[bytes, list[tuple[int, np.ndarray]]] = {}
        for row, number in enumerate(numbers):
            own = of_logs[starts[number] : starts[number + 1]]
            together.setdefault(windows.t0[own].tobytes(), []).append((row, own))
        for same in together.values():
            rows, edges = np.array([row for row, _ in same]), windows.t0[same[0][1]]
            late = delay[:, None] + skew[:, None] * (edges + 0.5 * windows.length - command.t[0])
            late = np.repeat(late, len(rows), axis=0)
            # (n, w, R) of R logs with windows at the same times: to the windows of all of them
            a, b = (
                each.transpose(0, 2, 1).reshape(windows.steps, -1, 1)
                for each in series.steps(rows, late, edges, windows.step, windows.steps)
            )
            parts.append((np.concatenate([own for _, own in same]), one, a, b))
    return parts


def _in_lanes(
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], windows: int, steps: int, lanes: int
) -> Tensor:
    """(n, W, L) from the results (n, w, R) of some windows each, and the result of each lane.

    Where all lanes have the same, they share its memory.
    """
    alike = all(each.shape[2] == 1 for _, _, each in parts)
    spread = [torch.from_numpy(each if alike else each.take(group, axis=2)) for _, group, each in parts]
    if len(parts) == 1 and len(parts[0][0]) == windows:
        return spread[0].expand(-1, -1, lanes)
    result = torch.empty(steps, windows, 1 if alike else lanes, dtype=torch.float64)
    for (own, _, _), each in zip(parts, spread, strict=True):
        result[:, torch.from_numpy(own)] = each
    return result.expand(-1, -1, lanes)


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the first of each distinct row, and for each row the number of its own."""
    numbers: dict[bytes, int] = {}
    # 0 is added because -0 has other bytes.
    member = [numbers.setdefault(row.tobytes(), len(numbers)) for row in rows + 0.0]
    first = np.unique(member, return_index=True)[1]
    return first, np.array(member)


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

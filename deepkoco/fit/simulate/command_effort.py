"""Compute the effort of the actuators over each integration step from zero-order-hold commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.per_log_differences import of_log
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.simulate.held_efforts import HeldEfforts
from deepkoco.fit.simulate.pieces import pieces_at_jumps
from deepkoco.systems import System
from deepkoco.systems.motion import CommandTiming


class TooManyLagsError(ValueError):
    """A command has more than two first-order lags in series."""


class Efforts(NamedTuple):
    """Efforts of all commands over the pieces of every integration step of every window.

    Attributes:
        begin: Per command (n P, W, L), effort at the start of each of the P pieces of each step, in the command's unit.
        slope: Per command (n P, W, L), its change per second.
        length: (n P, W, L) lengths of the pieces [s], 0 for a piece that there is not; None where steps are in one.
        pieces: Number P.
    """

    begin: tuple[Tensor, ...]
    slope: tuple[Tensor, ...]
    length: Tensor | None = None
    pieces: int = 1


def step_efforts(
    system: System, windows: Windows, parameters: Mapping[str, Tensor], lanes: int
) -> tuple[Tensor, Tensor]:
    """Start values and slopes of :func:`command_efforts` for a system with one command, in the order (L, W, n)."""
    found = command_efforts(system, windows, parameters, lanes)
    return found.begin[0].permute(2, 1, 0), found.slope[0].permute(2, 1, 0)


def command_efforts(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    lanes: int,
    differ: Mapping[str, Tensor] | None = None,
    at_jumps: bool = False,
) -> Efforts:
    """Compute start value a and slope b of every command's effort over every integration step of every window.

    The logged command passes the effects of the actuator, then its lags, then the delays. A delayed command can jump
    inside a step. The line a + b s over the step has the same integral and double integral as the true effort. Speed
    and angle after the step then have the order of the integrator, and they depend smoothly on the delay. A joint that
    dry friction holds is no such motion: before the jump it stays, and it leaves with what comes after. For it, steps
    are cut at the jumps. A sensing delay is added to the delay of the command; the window's state is then the state
    that the sensor shows. If the clock of the measurements is faster than that of the commands, the delay grows with
    the time since the log's first command. Within a window it is constant.

    Args:
        system: Gives ``shape_command`` and ``command_timing``.
        windows: W windows of n steps.
        parameters: Named values, each (L,) or scalar.
        lanes: Number L of lanes.
        differ: Parameter -> (K, 1) or (K, L) differences in each of K logs.
        at_jumps: Whether steps are cut where commands jump, see :func:`.pieces_at_jumps`.

    Raises:
        TooManyLagsError: More than two lags in series have a time constant above 0.
    """
    sent = [_sent(system, windows, parameters, lanes, k, differ) for k in range(len(system.commands))]
    cuts = [_cut(windows, together) for together in zip(*sent, strict=True)] if at_jumps else []
    pieces = max((cut.pieces for cut in cuts), default=1)
    lines = []
    for commands in sent:
        parts: list[list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = [[], []]
        for number, one in enumerate(commands):
            cut = cuts[number] if pieces > 1 else None
            group, a, b = _lines_of(windows, one, cut, pieces)
            parts[0].append((one.own, group, a))
            parts[1].append((one.own, group, b))
        lines.append([_in_lanes(part, len(windows), windows.steps * pieces, lanes) for part in parts])
    begin, slope = (tuple(own[k] for own in lines) for k in range(2))
    if pieces == 1:
        return Efforts(begin, slope)
    lengths = [(one.own, cut.group, cut.lengths(pieces)) for one, cut in zip(sent[0], cuts, strict=True)]
    return Efforts(begin, slope, _in_lanes(lengths, len(windows), windows.steps * pieces, lanes), pieces)


class _Sent(NamedTuple):
    """One command of logs with the same stamps, in one lane for all or in each of L.

    Attributes:
        own: (w,) windows of these logs.
        series: Efforts at the stamps, of each log and of lanes that differ.
        row: (L, w) row of the series for each lane and window.
        late: (L, w) delay [s].
        key: (L, 3) what makes lanes differ: row, delay and skew.
    """

    own: np.ndarray
    series: HeldEfforts
    row: np.ndarray
    late: np.ndarray
    key: np.ndarray


def _sent(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    lanes: int,
    index: int,
    differ: Mapping[str, Tensor] | None,
) -> list[_Sent]:
    """Return one command of all logs that have windows."""
    if len(windows.commands) > 1 and not differ and all(x.numel() == 1 for x in parameters.values()):
        return _sent_in_one_lane(system, windows, parameters, index)
    found = []
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
        distinct, member = np.zeros(1, dtype=int), np.zeros(computed, dtype=int)
        if computed > 1:
            # Lanes with the same efforts share one series.
            distinct, member = _distinct(np.column_stack([shaped[:, _probe(command, index)], *lags]))
        series = HeldEfforts(command, shaped[distinct], [lag[distinct] for lag in lags])
        found.append(_one_sent(windows, own, series, member[:, None], delay, skew))
    return found


def _sent_in_one_lane(
    system: System, windows: Windows, parameters: Mapping[str, Tensor], index: int
) -> list[_Sent]:
    """As :func:`_sent`, where all logs have the same parameters and there is one lane.

    Logs that share their stamps pass the actuator together: a search for lost commands makes a hundred of one log, and
    so does one for noise of the commands.
    """
    timing = system.command_timing(index, parameters)
    delay, skew, lags = _times(system, index, timing, 1)
    alike: dict[int, list[int]] = {}
    for number in np.unique(windows.log).tolist():
        alike.setdefault(id(windows.commands[number].t), []).append(number)
    found = []
    for numbers in alike.values():
        command = windows.commands[numbers[0]]
        given = torch.from_numpy(np.stack([windows.commands[n].column(index) for n in numbers], axis=1))
        shaped = system.shape_command(index, given, torch.from_numpy(command.t), parameters)
        effort = np.ascontiguousarray(shaped.expand(len(given), len(numbers)).numpy().T)
        series = HeldEfforts(command, effort, [lag.repeat(len(numbers)) for lag in lags])
        own = np.flatnonzero(np.isin(windows.log, numbers))
        row = np.searchsorted(numbers, windows.log[own])[None]
        found.append(_one_sent(windows, own, series, row, delay, skew))
    return found


def _one_sent(
    windows: Windows,
    own: np.ndarray,
    series: HeldEfforts,
    row: np.ndarray,
    delay: np.ndarray,
    skew: np.ndarray,
) -> _Sent:
    middle = windows.t0[own] + 0.5 * windows.length - series.t[0]
    late = delay[:, None] + skew[:, None] * middle
    row = np.broadcast_to(row, late.shape)
    return _Sent(own, series, row, late, np.column_stack([row[:, 0], delay, skew]))


class _Cut(NamedTuple):
    """Pieces of the steps of some windows.

    Attributes:
        length: (n, P, w, G) lengths [s] in each of G groups of lanes.
        group: (L,) group of each lane; (1,) where all lanes are one.
    """

    length: np.ndarray
    group: np.ndarray

    @property
    def pieces(self) -> int:
        """Number P."""
        return self.length.shape[1]

    def lengths(self, pieces: int) -> np.ndarray:
        """(n P, w, G) lengths with more pieces, which there are not."""
        more = np.zeros((len(self.length), pieces - self.pieces, *self.length.shape[2:]))
        whole = np.concatenate([self.length, more], axis=1)
        return whole.reshape(-1, *whole.shape[2:])


def _cut(windows: Windows, commands: Sequence[_Sent]) -> _Cut:
    """Cut the steps of some windows where any of their commands jumps.

    The logged commands tell where, so that no lane is cut because of another one.
    """
    own, count = commands[0].own, max(len(each.key) for each in commands)
    keys = np.concatenate([np.broadcast_to(each.key[:, 1:], (count, 2)) for each in commands], axis=1)
    distinct, group = _distinct(keys) if count > 1 else (np.zeros(1, dtype=int), np.zeros(1, dtype=int))
    late = np.stack([np.broadcast_to(each.late, (count, len(own)))[distinct] for each in commands])
    logs, of_window = np.unique(windows.log[own], return_inverse=True)
    jumps = np.stack(
        [
            [np.diff(windows.commands[log].column(k)) != 0.0 for log in logs.tolist()]
            for k in range(len(commands))
        ]
    )
    stamps = commands[0].series.t
    length = pieces_at_jumps(stamps, jumps, of_window, late, windows.t0[own], windows.step, windows.steps)
    return _Cut(length, group)


def _lines_of(
    windows: Windows, one: _Sent, cut: _Cut | None, pieces: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return group (L,) of each lane, and start values and slopes (n P, w, R) of these groups."""
    count = len(one.key) if cut is None else max(len(one.key), len(cut.group))
    key, t0 = np.broadcast_to(one.key, (count, 3)), windows.t0[one.own]
    if cut is not None:
        key = np.column_stack([key, np.broadcast_to(cut.group, count)])
    distinct, group = np.zeros(1, dtype=int), np.zeros(count, dtype=int)
    if count > 1:
        distinct, group = _distinct(key)
    row, late = (np.broadcast_to(x, (count, len(t0)))[distinct] for x in (one.row, one.late))
    if cut is None:
        return group, *one.series.steps(row, late, t0, windows.step, windows.steps)
    length = cut.lengths(pieces)
    begin = np.repeat(windows.step * np.arange(windows.steps), pieces)[:, None, None]
    parts = length.reshape(-1, pieces, *length.shape[1:])
    edges = begin + (np.cumsum(parts, axis=1) - parts).reshape(length.shape)
    edges = np.concatenate([edges, np.full((1, *edges.shape[1:]), windows.length)])
    which = np.broadcast_to(cut.group, count)[distinct]
    return group, *one.series.between(row, late, t0, edges, which)


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

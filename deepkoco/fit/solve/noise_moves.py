"""Moves of the measurements of windows by noise of their commands, a piece of it at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.series import CommandSeries
from deepkoco.fit.data.windows import HISTORY, WARM_UP, Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit

PIECES = 96  # of noise of a command in one window at most; each is the mean of some neighbouring commands
LARGEST = 1 << 27  # moves by pieces of noise that are kept at once
FEWEST = 16  # pieces of a command in one window, however many windows there are
EARLY = 1e-9  # by which a command may be before a span [s]
LANES = 2000  # windows in one batch of simulations


def moves_by_noise(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, fit: Fit, sd: Sequence[float]
) -> Tensor:
    """Return the moves (W, N, M, P) of the measurements by one standard deviation of each piece of noise.

    Commands before a window act through its initial state. Where there are many commands in it, neighbours share a
    piece, of the standard deviation of their mean.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows.
        fit: A simulation of them.
        sd: Standard deviation of the noise of each command, in its unit.
    """
    first, last = inside(windows, np.arange(len(windows)), windows.t0, windows.length)
    return moves_of(
        problem_of, windows, fit, sd, np.arange(len(windows)), first, int((last - first).max())
    ).flatten(-2)


def inside(
    windows: Windows, rows: np.ndarray, begin: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of the first command in each span [s] of some windows, and of the first one after it."""
    found = [
        np.searchsorted(windows.commands[windows.log[w]].t, [at - EARLY, at + length - EARLY])
        for w, at in zip(rows, begin, strict=True)
    ]
    first, last = np.array(found, dtype=int).reshape(-1, 2).T
    return first, last


def moves_of(
    problem_of: Callable[[Windows], FitProblem],
    windows: Windows,
    fit: Fit,
    sd: Sequence[float],
    rows: np.ndarray,
    first: np.ndarray,
    count: int,
) -> Tensor:
    """Return the moves (R, N, M, C, P) of the measurements of some windows by noise of each of C commands.

    Args:
        problem_of, windows, fit, sd: As for :func:`moves_by_noise`.
        rows: (R,) windows.
        first: (R,) number of the first command whose noise counts.
        count: How many commands count.
    """
    exact, fit = problem_of(windows).as_fitted(fit)
    windows, theta = exact.windows, np.array([[float(fit.values[n]) for n in exact.names]])
    # Long logs have many windows, and coarser pieces keep all of them in memory.
    most = min(max(LARGEST // max(len(rows) * windows.value[0].numel() * len(sd), 1), FEWEST), PIECES)
    each = max(math.ceil(count / most), 1)
    pieces = max(math.ceil(count / each), 1)
    result = torch.zeros(len(rows), *windows.value.shape[1:], len(sd), pieces, dtype=torch.float64)
    block = max(LANES // pieces, 1)
    acting = {w: _acting(windows, w) for w in np.unique(rows).tolist()}
    for index, size in enumerate(sd):
        for begin in range(0, len(rows) if size > 0.0 else 0, block):
            picked = np.arange(begin, min(begin + block, len(rows)))
            # The first of each window is the simulation that is moved, from the same commands.
            places = np.concatenate([first[picked, None], first[picked, None] + each * np.arange(pieces)], 1)
            sizes = np.append(0.0, np.full(pieces, size / math.sqrt(each)))
            of_window = np.repeat(rows[picked], pieces + 1)
            logs = windows.log[of_window]
            commands = tuple(
                _moved(acting[int(w)], index, int(at), each, float(by))
                for w, at, by in zip(of_window, places.ravel(), np.tile(sizes, len(picked)), strict=True)
            )
            many = replace(
                windows.take(of_window),
                commands=commands,
                log=np.arange(len(of_window)),
                known=tuple(windows.known[log] for log in logs) if windows.known else (),
                stamp_sd=tuple(windows.stamp_sd[log] for log in logs) if windows.stamp_sd else (),
            )
            problem, index_of = problem_of(many), torch.from_numpy(of_window)
            shown = problem.predict(theta, fit.state[index_of][None], problem.nuisances.none()[None])[0]
            shown = shown.unflatten(0, (len(picked), pieces + 1))
            moved = shown[:, 1:] - shown[:, :1]
            moved = torch.where(torch.isfinite(moved), moved, 0.0)
            result[picked, :, :, index] = moved.permute(0, 2, 3, 1)
    return result


def _acting(windows: Windows, w: int) -> tuple[CommandSeries, int]:
    """Return the commands that act in a window, and the number of the first of them in their log."""
    command = windows.commands[windows.log[w]]
    begin, end = windows.t0[w] - HISTORY - WARM_UP * windows.length, windows.t0[w] + windows.length
    first = max(int(np.searchsorted(command.t, begin)) - 1, 0)
    part = slice(first, int(np.searchsorted(command.t, end)) + 1)
    return CommandSeries(command.t[part], np.array(command.value[part], dtype=float)), first


def _moved(acting: tuple[CommandSeries, int], index: int, first: int, count: int, by: float) -> CommandSeries:
    """Return commands with some of one command moved; they share their stamps, so one pass simulates all of them.

    Args:
        acting: The commands of a window, and the number of the first of them in their log.
        index: Which command is moved.
        first: Number of the first value that is moved, in the log.
        count: How many values are moved.
        by: By how much.
    """
    command, start = acting
    value = command.value.copy()
    column = value if value.ndim == 1 else value[:, index]
    column[max(first - start, 0) : max(first - start + count, 0)] += by
    return CommandSeries(command.t, value)

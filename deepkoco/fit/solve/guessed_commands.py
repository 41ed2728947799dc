"""Commands in the place of rows that a log lost, fitted to what the sensors show of them.

A command that acted for one row is an impulse at a known time. Each moves the windows that it acts in, so that a few
samples after it tell its size, beside the initial state of the window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.series import CommandSeries
from deepkoco.fit.data.windows import HISTORY, Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.solve.levenberg_marquardt import LEAST_DAMPING
from deepkoco.fit.solve.normal_equations import NormalEquations
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.tangent import Tangent, simulated

ROUNDS = 6  # of steps, each with a fit of all else
LITTLE = 1e-3  # share by which a round lowers chi2 after which there is no other
NOISE = 1.2  # variances of the noise that are left where nothing is missing
STEP = 0.1  # of a guess for its slope, in sizes of its error


def guesses_in(windows: Windows) -> bool:
    """Return whether commands of these windows stand in the place of lost rows."""
    return any(series.guessed is not None and bool(series.guessed.any()) for series in windows.commands)


def with_lost_rows_fitted(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, fit: Fit, prior: Prior
) -> tuple[Windows, Fit]:
    """Fit the commands in the place of lost rows with all that a fit frees, where only noise is left then.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows.
        fit: A fit of them.
        prior: Prior of its free parameters.

    Returns:
        The windows, with commands that count as known, and their fit; both as they are where more than noise is left.
    """
    if not guesses_in(windows):
        return windows, fit
    other, again = windows, fit
    for _ in range(ROUNDS):
        moved, begin = with_guesses_fitted(problem_of, other, windows, again, prior)
        lower = problem_of(moved).fit([begin])[0]
        if lower.diverged or not lower.chi2 < again.chi2:
            break
        falls = again.chi2 - lower.chi2 > LITTLE * lower.chi2
        other, again = moved, lower
        if not falls:
            break
    # What commands explain of a fault would be missing when a cause is asked for.
    if again.chi2 > NOISE * max(windows.samples, 1):
        return windows, fit
    return replace(other, commands=tuple(replace(c, guessed=None) for c in other.commands)), again


def with_guesses_fitted(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, given: Windows, fit: Fit, prior: Prior
) -> tuple[Windows, Trial]:
    """Take one Gauss-Newton step of the commands in the place of lost rows, with all that a fit frees.

    The prior of the error of a guess is compared with what the fit leaves, which may be more than noise: a model error
    is then not explained by these commands.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows.
        given: The windows before the first step.
        fit: A fit of ``windows``.
        prior: Prior of its free parameters.

    Returns:
        The windows with other commands, and a trial that begins at the other values and states.
    """
    problem = problem_of(windows)
    columns = np.array([problem.names.index(n) for n in fit.free], dtype=int)
    theta = np.array([float(fit.values[n]) for n in problem.names])
    tangent = Tangent.at(problem, theta, columns, fit.state)
    usual = simulated(problem, [tangent], fit.nuisance[None])
    slopes = tangent.slopes(usual, problem).flatten(2)  # (p + S, W, NM)
    residual = problem.weighed(windows.value - usual[0]).flatten(1)
    ranks, lanes = _lanes(windows)
    errors = [_errors(series) for series in given.commands]
    count, size = errors[0].shape[1], fit.state.shape[1]
    # Each lane moves one guess of each window by a share of its error.
    moved = []
    for m in range(count):
        for lane in range(lanes):
            these = tuple(
                _moved(series, rank, sd, m, STEP * (rank % lanes == lane))
                for series, rank, sd in zip(windows.commands, ranks, errors, strict=True)
            )
            other = problem_of(replace(windows, commands=these))
            shown = other.predict(theta[None], fit.state[None], fit.nuisance[None])[0]
            moved.append((problem.weighed(shown - usual[0]) / STEP).flatten(1))
    guesses = torch.stack(moved)  # (M lanes, W, NM)
    # A guess is a state of its window, and its prior is one more residual.
    tight = max(fit.chi2 / max(windows.samples, 1), 1.0) ** 0.5
    already = _already(windows, given, ranks, lanes, errors)  # (W, M lanes)
    own = tight * torch.eye(count * lanes, dtype=torch.float64)[:, None].expand(-1, len(windows), -1)

    def padded(rows: Tensor) -> Tensor:
        return torch.nn.functional.pad(rows, (0, count * lanes))[..., None]

    state_slopes = torch.cat([padded(slopes[len(columns) :]), torch.cat([guesses, own], -1)[..., None]])
    matrix, offset = map(torch.from_numpy, prior.penalty(fit.free).at(theta[columns]))
    none = torch.zeros(0, dtype=torch.float64)
    normal = NormalEquations.build(
        torch.cat([residual, -tight * already], -1)[..., None],
        padded(slopes[: len(columns)]),
        state_slopes,
        padded(slopes[:0]),
        matrix,
        offset,
        none,
        none,
    )
    begin = Trial("lost rows", fit.free, prior, fit.values, fit.state, fit.nuisance)
    if not normal.finite:
        return windows, begin
    move, states, _ = normal.solve(LEAST_DAMPING, np.zeros(len(columns), dtype=bool), np.zeros(len(columns)))
    there = np.clip(theta[columns] + move, problem.low[columns], problem.high[columns])
    values = {**fit.values, **dict(zip(fit.free, map(float, there), strict=True))}
    steps = states[:, size:].unflatten(1, (count, lanes)).numpy()
    commands = list(windows.commands)
    told = (guesses**2).sum(-1).T.unflatten(1, (count, lanes)).numpy()
    for log, series in enumerate(commands):
        total, weight = np.zeros(errors[log].shape), np.full(errors[log].shape, 1e-30)
        for w in np.flatnonzero(windows.log == log):
            # A late command of one window acts in the next one.
            inside = _inside(windows, series, int(w))
            own = ranks[log][inside] % lanes
            total[inside] += (told[w] * steps[w]).T[own]
            weight[inside] += told[w].T[own]
        step = errors[log] * total / weight
        commands[log] = replace(series, value=series.value + (step[:, 0] if series.value.ndim == 1 else step))
    begin = replace(begin, values=values, state=fit.state + states[:, :size])
    return replace(windows, commands=tuple(commands)), begin


def _already(
    windows: Windows, given: Windows, ranks: list[np.ndarray], lanes: int, errors: list[np.ndarray]
) -> Tensor:
    """By how many sizes of their errors the guesses (W, M lanes) of each window are off their first values."""
    count = errors[0].shape[1]
    result = np.zeros((len(windows), count, lanes))
    for w in range(len(windows)):
        log = int(windows.log[w])
        series, first, sd = windows.commands[log], given.commands[log], errors[log]
        inside = _inside(windows, series, w)
        off = np.atleast_2d((series.value - first.value).T).T[inside] / np.where(sd > 0.0, sd, 1.0)[inside]
        result[w][:, ranks[log][inside] % lanes] = off.T
    return torch.from_numpy(result).flatten(1)


def errors_of_guesses(column: np.ndarray, guessed: np.ndarray, size: int) -> np.ndarray:
    """Errors (n, size) of values between those of their neighbours, wherever so many known ones were left out.

    Args:
        column: (n,) values of a command.
        guessed: (n,) True for values that are not known.
        size: How many in turn are left out.
    """
    span, unknown = size + 2, np.append(0, np.cumsum(guessed))
    begins = np.arange(max(len(column) - span + 1, 0))
    begins = begins[unknown[begins + span] == unknown[begins]]
    known = column[begins[:, None] + np.arange(span)]
    share = np.arange(1, span - 1) / (span - 1)
    return known[:, 1:-1] - (known[:, :1] + share * (known[:, -1:] - known[:, :1]))


def _errors(series: CommandSeries) -> np.ndarray:
    """Sizes (n, M) of the errors of guesses; 0 for commands that are known.

    A command jumps seldom, and then its row may be the one that was lost: the largest error that known commands show
    counts. The loop may also have skipped its turn, so that the command before held on.
    """
    columns = np.atleast_2d(series.value.T)
    result = np.zeros((len(series.t), len(columns)))
    if series.guessed is not None:
        for m, column in enumerate(columns):
            for start, size in runs_of(series.guessed):
                errors = errors_of_guesses(column, series.guessed, size)
                largest = np.abs(errors).max(0) if len(errors) else 0.0
                result[start : start + size, m] = largest + np.abs(
                    column[start : start + size] - column[start - 1]
                )
    return result


def runs_of(guessed: np.ndarray) -> list[tuple[int, int]]:
    """First index and length of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], guessed.astype(int), [0]])))
    return [(int(start), int(stop - start)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _lanes(windows: Windows) -> tuple[list[np.ndarray], int]:
    """Number (n,) of each guess of each log, -1 for known commands, and the most guesses in one window."""
    ranks, most = [], 1
    for log, series in enumerate(windows.commands):
        guessed = np.zeros(len(series.t), dtype=bool) if series.guessed is None else series.guessed
        ranks.append(np.where(guessed, np.cumsum(guessed) - 1, -1))
        for w in np.flatnonzero(windows.log == log):
            most = max(most, int(_inside(windows, series, int(w)).sum()))
    return ranks, most


def _inside(windows: Windows, series: CommandSeries, w: int) -> np.ndarray:
    """(n,) True for the guesses that may act in a window."""
    if series.guessed is None:
        return np.zeros(len(series.t), dtype=bool)
    begin = windows.t0[w]
    return series.guessed & (series.t >= begin - HISTORY) & (series.t < begin + windows.length)


def _moved(
    series: CommandSeries, rank: np.ndarray, errors: np.ndarray, m: int, by: np.ndarray
) -> CommandSeries:
    """Return commands of which the guesses of one command are moved by so many sizes of their errors."""
    if series.guessed is None:
        return series
    value = np.atleast_2d(series.value.T).T.copy()
    value[:, m] += np.where(rank >= 0, by * errors[:, m], 0.0)
    return replace(series, value=value[:, 0] if series.value.ndim == 1 else value)

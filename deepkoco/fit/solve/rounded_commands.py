"""Noise of a simulation whose commands are known up to the rounding of the log.

A log with a current in whole mA does not hold the current that acted. The difference is a small random force that the
unit felt and the simulation does not: integrated twice over a window, it moves a joint by more than a fine encoder
shows, whatever the parameters are. Commands that were put in for rows that a log lost leave the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.series import CommandSeries
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit
from deepkoco.fit.solve.guessed_commands import errors_of_guesses, guesses_in, runs_of
from deepkoco.logs.quantum import quantum_of

# Levels of a command from which its grid is taken for that of a log. Fewer are levels that somebody chose, and the log
# holds them exactly.
MANY_LEVELS = 300
DRAWS = 6  # roundings that are simulated
CHANCE = (
    2.0  # standard deviations by which the roundings of this log may move more than the mean of the draws
)
STATE_STEPS = 4  # iterations for the initial states, which follow almost linearly
EXACT = 0.01  # share of the sensors' noise to which they are fitted


def with_rounded_commands(problem_of: Callable[[Windows], FitProblem], windows: Windows, fit: Fit) -> Windows:
    """Return windows whose noise contains what the rounding of the commands does to a simulation.

    Roundings, and errors of commands in the place of lost rows, are drawn and simulated, and the initial states are
    fitted to the result. What then differs from the fit is the part that no simulation can follow. A command may also
    be exact on its grid, so a channel gets no more noise than the fit has left in it.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows, with the noise of the sensors.
        fit: A fit of them.

    Returns:
        The windows; the same ones where no command is rounded or put in.
    """
    quanta = [_quanta(series) for series in windows.commands]
    if not (guesses_in(windows) or any(q.any() for q in quanta)) or len(windows) == 0:
        return windows
    theta = np.array([[float(fit.values[n]) for n in problem_of(windows).names]])

    def simulated(of: FitProblem, state: Tensor) -> Tensor:
        return of.predict(theta, state[None], fit.nuisance[None])[0]

    # States are fitted until they are exact, which is far below the noise of the sensors.
    sharp = replace(windows, noise=tuple(n._replace(sd=EXACT * n.sd) for n in windows.noise), stamp_sd=())
    rng, draws, valid = np.random.default_rng(0), [], windows.valid
    for _ in range(DRAWS):
        pairs = zip(windows.commands, quanta, strict=True)
        other = replace(windows, commands=tuple(_unrounded(series, q, rng) for series, q in pairs))
        moved = simulated(problem_of(other), fit.state)
        problem = problem_of(sharp.with_value(moved))
        state = problem.fit_states_each([fit.values], fit.state[None], STATE_STEPS, fit.nuisance[None])[0][0]
        error = torch.where(valid, moved - simulated(problem, state), 0.0).square()
        draws.append((error.sum((0, 2)) / valid.sum((0, 2)).clamp(min=1)).numpy())
    variance = np.mean(draws, axis=0) + CHANCE * np.std(draws, axis=0, ddof=1)
    left = (fit.residual * windows.sample_sd).square().sum((0, 2)) / valid.sum((0, 2)).clamp(min=1)
    noise = tuple(
        n.with_simulated(max(min(v, most - n.sd**2), 0.0))
        for n, v, most in zip(windows.noise, variance.tolist(), left.tolist(), strict=True)
    )
    return replace(windows, noise=noise)


def _quanta(series: CommandSeries) -> np.ndarray:
    """(M,) Grid of each command of a log; 0 where its values are on none, or may be exact there."""
    columns = np.atleast_2d(series.value.T)
    quanta = np.array([quantum_of(column) for column in columns])
    return np.where(np.ptp(columns, axis=1) >= MANY_LEVELS * quanta, quanta, 0.0)


def _unrounded(series: CommandSeries, quanta: np.ndarray, rng: np.random.Generator) -> CommandSeries:
    """Return commands that the log might have rounded to these; a value that is held has one rounding."""
    columns = np.atleast_2d(series.value.T)
    guessed = series.guessed if series.guessed is not None and series.guessed.any() else None
    result = []
    for column, quantum in zip(columns, quanta, strict=True):
        held = np.append(0, np.cumsum(np.diff(column) != 0.0))
        other = column + quantum * rng.uniform(-0.5, 0.5, held[-1] + 1)[held]
        result.append(other if guessed is None else other + _errors_of_guesses(column, guessed, rng))
    value = np.stack(result, axis=-1)
    return replace(series, value=value[:, 0] if series.value.ndim == 1 else value)


def _errors_of_guesses(column: np.ndarray, guessed: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw errors (n,) of values that lie between those of their neighbours, as known values show them.

    Where as many known values in a row were left out as a gap has lost, the values between would miss them by these.
    """
    errors = np.zeros(len(column))
    for start, size in runs_of(guessed):
        if len(known := errors_of_guesses(column, guessed, size)):
            errors[start : start + size] = rng.choice(known)
    return errors

"""What noise of the commands of a log does to a simulation of it, where the log shows such noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.likely_commands import likely_commands
from deepkoco.fit.data.noise import estimate_noise
from deepkoco.fit.data.series import CommandSeries
from deepkoco.fit.data.wander import Wander, compressed
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.solve.noise_moves import moves_by_noise
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.shown_noise import shown_noise

LEFT = 0.25  # noise variances of a typical sample that count as noise of the sensors
MOST = 96  # pieces of noise that are told from it


def with_command_noise(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, values: Mapping[str, float], state: Tensor
) -> Windows:
    """Return windows with their most likely commands and what noise of these does, where they have noise.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows, with the noise of the sensors.
        values: Parameters near those of the unit.
        state: (W, S) initial states to begin with.

    Returns:
        The windows; the same ones where the motion answers the commands as logged, or does not tell.
    """
    most = noise_of_commands(windows)
    if len(windows) == 0 or not any(most):
        return windows
    fit = _simulation(problem_of(windows), values, state)
    if fit.diverged:
        return windows
    shown = shown_noise(problem_of, windows, fit, most)
    if shown.share == 0.0:
        return windows
    sd, logged = (tuple(math.sqrt(share) * each for each in most) for share in shown)
    return with_noise(problem_of, windows, fit, sd, logged)


def with_noise(
    problem_of: Callable[[Windows], FitProblem],
    windows: Windows,
    fit: Fit,
    sd: tuple[float, ...],
    logged: tuple[float, ...],
) -> Windows:
    """Return windows with their most likely commands, and what noise of their size does to the measurements.

    All of the noise counts, also what the log tells of it: that is little of what matters, the slow part.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows, with the noise of the sensors.
        fit: A simulation of them.
        sd: Standard deviation of the noise of each command, in its unit.
        logged: Square root of its covariance with the logged command.
    """
    windows = replace(windows, commands=likely_commands(windows.commands, logged))
    moves = moves_by_noise(problem_of, windows, fit, sd)
    weight = windows.valid.to(torch.float64) / windows.sample_sd
    few, rest = compressed(moves, weight, LEFT, MOST)
    noise = tuple(
        n.with_simulated(variance) for n, variance in zip(windows.noise, rest.tolist(), strict=True)
    )
    return replace(windows, noise=noise, wander=Wander(sd, few, logged))


def with_noise_like(
    problem_of: Callable[[Windows], FitProblem],
    windows: Windows,
    values: Mapping[str, float],
    like: Wander | None,
) -> Windows:
    """Return windows with the noise of commands that others of the same recorder have, at some parameters."""
    if like is None or len(windows) == 0:
        return windows
    fit = _simulation(problem_of(windows), values, windows.state)
    return windows if fit.diverged else with_noise(problem_of, windows, fit, like.sd, like.logged)


def _simulation(problem: FitProblem, values: Mapping[str, float], state: Tensor) -> Fit:
    found, _ = problem.fit_states(values, state)
    return problem.fit([Trial("noise of the commands", (), Prior.empty(), values, found)], 1)[0]


def noise_of_commands(windows: Windows) -> tuple[float, ...]:
    """Standard deviation of the noise of each command at most, in its unit: what no smooth motion has of it."""
    found = []
    for index in range(windows.commands[0].value[:, None].reshape(len(windows.commands[0].t), -1).shape[1]):
        parts = [
            (len(c.t), _noise_of(c, index))
            for log, c in enumerate(windows.commands)
            if (windows.log == log).any() and np.ptp(c.column(index)) > 0.0
        ]
        total = sum(n for n, _ in parts)
        found.append(math.sqrt(sum(n * sd**2 for n, sd in parts) / total) if total else 0.0)
    return tuple(found)


def _noise_of(command: CommandSeries, index: int) -> float:
    """Standard deviation of the noise of a command, as independent noise of each of its rows that does the same."""
    value = command.column(index)
    changes = np.append(0, np.flatnonzero(np.diff(value) != 0.0) + 1)
    held = max(float(np.median(np.diff(changes))), 1.0) if len(changes) > 1 else 1.0
    return estimate_noise(command.t[changes], value[changes], 0.0).sd * math.sqrt(held)

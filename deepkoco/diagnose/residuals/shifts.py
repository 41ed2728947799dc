"""A moved zero of a position sensor: when it explains most of what a fit leaves."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.fit import FitProblem

MOST = 3  # starts
APART = 10  # samples between two of one window
QUICK = 2.0  # sample periods in which a zero moves at its starts


def shifts_of_zero(
    problem: FitProblem, joint: int, residual: Tensor, basis: Tensor
) -> tuple[dict[str, float], ...]:
    """Return parameters of the moves of a joint's zero that lower chi2 most, the best first; none for several logs.

    A zero that moves at a sample is a step in the residuals of that window, and a constant in those of all later ones.
    Whatever of it an initial state explains is taken out. Parameters of the simulation are not: what these explain is
    asked when the starts are screened.

    Args:
        problem: W windows with N channels of M samples.
        joint: The joint.
        residual: (W, NM, 1) residuals in noise standard deviations, without what initial states explain.
        basis: (W, NM, S) orthonormal responses to the initial states.
    """
    windows = problem.windows
    channels = _channels(problem, joint)
    if len(np.unique(windows.log)) > 1 or not channels or not len(windows):
        return ()
    match, energy = _told(problem, channels, residual, basis)
    order = np.argsort(windows.t0)
    later_match, later_energy = np.zeros((2, len(windows)))
    later_match[order] = _after(match[order, 0])
    later_energy[order] = _after(energy[order, 0])
    total, known = match + later_match[:, None], energy + later_energy[:, None]
    valid = windows.valid[:, channels[0]].numpy()
    amount, fall = _explained(total, known, valid)
    times = windows.t[:, channels[0]].numpy()
    began = float(windows.commands[int(windows.log[0])].t[0])
    period = float(np.median(np.diff(times, axis=1)[valid[:, 1:] & valid[:, :-1]]))
    found = []
    for _ in range(MOST):
        w, k = np.unravel_index(int(np.argmax(fall)), fall.shape)
        if not fall[w, k] > 0.0:
            break
        start = float(windows.t0[w] + times[w, k]) - began - 0.5 * (QUICK + 1.0) * period
        found.append({"angle": float(amount[w, k]), "start": max(start, 0.0), "duration": QUICK * period})
        fall[w, max(k - APART, 0) : k + APART] = -np.inf
    return tuple(found)


def steps_of_zero(problem: FitProblem, joint: int, residual: Tensor, basis: Tensor) -> np.ndarray:
    """Return (W,) the largest fall of chi2 by a step of a joint's zero within each window; all as above."""
    channels = _channels(problem, joint)
    if not channels or not len(problem.windows):
        return np.zeros(len(problem.windows))
    match, energy = _told(problem, channels, residual, basis)
    _, fall = _explained(match, energy, problem.windows.valid[:, channels[0]].numpy())
    return np.maximum(fall.max(1), 0.0)


def _channels(problem: FitProblem, joint: int) -> list[int]:
    """Channels of a joint's position that the log has, with the stamps of the first of them."""
    windows = problem.windows
    own = [c for c, s in enumerate(windows.shows) if s == joint and bool(windows.valid[:, c].any())]
    return [c for c in own if torch.equal(windows.t[:, c], windows.t[:, own[0]])]


def _told(
    problem: FitProblem, channels: list[int], residual: Tensor, basis: Tensor
) -> tuple[np.ndarray, np.ndarray]:
    """Slope and curvature (W, M) of half of chi2 by a step at each sample, that lasts to the end of its window."""
    count, size, samples = problem.windows.value.shape
    # A step is whitened as residuals are, by a symmetric matrix, so whitening these once more tells the same.
    own = problem.whitened(residual.reshape(count, size, samples)).numpy()
    columns = problem.whitened(basis.reshape(count, size, samples, -1).movedim(-1, 0)).movedim(0, -1)
    if problem.whitening is not None:
        columns = torch.cat([columns, problem.whitening.hidden.reshape(count, size, samples, -1)], -1)
    states = columns.numpy()
    weight = problem.weight.numpy()
    match, energy = np.zeros((2, count, samples))
    shown = np.zeros((count, samples, states.shape[-1]))
    for c in channels:
        match += _from_here(weight[:, c] * own[:, c])
        energy += _from_here(weight[:, c] ** 2)
        shown += _from_here(weight[:, c, :, None] * states[:, c])
    return match, energy - (shown**2).sum(-1)


def _explained(match: np.ndarray, energy: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Best step, and its fall of chi2, at each sample (W, M); minus infinity where none can be told."""
    # What is left of a step after the initial state is rounding at the ends of a window.
    sound = valid & (energy > 1e-6 * energy.max())
    amount = np.where(sound, match / np.where(sound, energy, 1.0), 0.0)
    return amount, np.where(sound, match * amount, -np.inf)


def _from_here(values: np.ndarray) -> np.ndarray:
    """Sum of each value of the samples (W, M, ...) and those after it."""
    return np.flip(np.cumsum(np.flip(values, 1), 1), 1)


def _after(values: np.ndarray) -> np.ndarray:
    """Sum of the values (W,) after each one."""
    return np.cumsum(values[::-1])[::-1] - values

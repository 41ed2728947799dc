"""Held-out error of a simulation: windows from measured start states, which are searched alike for every entrant."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from experiments.studies.diagnosis.hidden_cause.questions import Simulate

ITERATIONS = 8
NUDGE = 1e-5  # of a coordinate of a start state
GROW, SHRINK = 10.0, 0.2  # of the damping


def blank(windows: Windows) -> Windows:
    """Return windows without their measurements: commands, stamps and lengths only."""
    return replace(windows, value=torch.zeros_like(windows.value), state=torch.zeros_like(windows.state))


def held_out_error(simulate: Simulate, windows: Windows, joints: int) -> float:
    """Return the root mean square error of the positions, in standard deviations of their noise; inf if it diverges.

    Each window starts from the state that fits best, by Levenberg-Marquardt from the measured one: the same search for
    every simulation, as in the held-out measure of the package.

    Args:
        simulate: The simulation.
        windows: Held-out windows with measurements.
        joints: Number of joints J; the first J states are the positions.
    """
    residual = best_residual(simulate, windows)
    shown = [c for c, s in enumerate(windows.shows) if s < joints]
    valid = windows.valid[:, shown]
    total = float((residual[:, shown][valid] ** 2).mean())
    return math.sqrt(total) if math.isfinite(total) else math.inf


def best_residual(simulate: Simulate, windows: Windows) -> Tensor:
    """Return the whitened residuals (W, N, M) from the best start states that are found."""
    unseen, weight = blank(windows), windows.valid.to(torch.float64) / windows.sample_sd
    state = windows.state.clone()
    size = state.shape[1]

    def residuals(starts: Tensor) -> Tensor:
        shown = simulate(unseen, starts)
        return torch.where(windows.valid, (windows.value - shown) * weight, 0.0)

    best = residuals(state[None])[0]
    damping = torch.full((len(windows),), 1e-3, dtype=torch.float64)
    for _ in range(ITERATIONS):
        lanes = state[None].repeat(size, 1, 1)
        for s in range(size):
            lanes[s, :, s] += NUDGE
        slopes = ((residuals(lanes) - best) / NUDGE).flatten(2).permute(1, 2, 0)  # (W, samples, S)
        slopes = torch.nan_to_num(slopes, 0.0, 0.0, 0.0)
        flat = torch.nan_to_num(best.flatten(1), 0.0, 0.0, 0.0)
        normal = slopes.mT @ slopes
        scale = normal.diagonal(dim1=1, dim2=2).clamp_min(1e-12)
        damped = normal + torch.diag_embed(damping[:, None] * scale + 1e-12)
        step = -torch.linalg.solve(damped, (slopes.mT @ flat[..., None]))[..., 0]
        tried = residuals((state + step)[None])[0]
        before, after = _cost(best), _cost(tried)
        better = after < before
        state = torch.where(better[:, None], state + step, state)
        best = torch.where(better[:, None, None], tried, best)
        damping = torch.where(better, damping * SHRINK, damping * GROW)
        if not better.any() or bool(((before - after)[better] < 1e-6 * before[better]).all()):
            break
    return best


def _cost(residual: Tensor) -> Tensor:
    return torch.nan_to_num(residual.square().sum((1, 2)), math.inf, math.inf, math.inf)

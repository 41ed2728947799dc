"""Batched multiple-shooting simulator: lanes (parameter sets) times windows, one tensor."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.identify.effort import step_efforts
from deepkoco.identify.windows import Windows
from deepkoco.systems import System

# The sign of dry friction is smoothed over at least SHARPEST [rad/s], and over as much speed as the joint
# gains in CROSSING steps. A fast reversal inside one step would otherwise see the sign at the four stages
# only; spread over the step it gives the right impulse, since the smoothed sign is odd about the reversal.
SHARPEST = 0.03
CROSSING = 0.3
SMOOTHED = ("coulomb_smoothing", "coulomb.smoothing", "stribeck.smoothing")


def trajectories(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    initial: Tensor,
    push: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Simulate every window under its logged commands.

    Args:
        system: Dynamics.
        windows: W windows of n steps.
        parameters: Named values, each (L,) or scalar.
        initial: (L, W, S) states at the start of the windows.
        push: (L, W, n) extra torque on the joint over each step [N m]; None for none.

    Returns:
        States (n + 1, L, W, S), derivative at the start and at the end of each step (n, L, W, S).

    Source: classical Runge-Kutta with an effort that is linear in time within the step.
    """
    lanes = initial.shape[0]
    start, slope = step_efforts(system, windows, dict(parameters), lanes)
    h = windows.step
    named = {name: value[:, None] if value.ndim else value for name, value in parameters.items()}
    state = initial
    states = torch.empty(windows.steps + 1, *initial.shape, dtype=torch.float64)
    left = torch.empty(windows.steps, *initial.shape, dtype=torch.float64)
    right = torch.empty_like(left)
    states[0] = state
    start, slope = start.movedim(2, 0).contiguous(), slope.movedim(2, 0).contiguous()
    pushes = None if push is None else push.movedim(2, 0).contiguous()
    width = torch.full((), SHARPEST, dtype=torch.float64)
    for i in range(windows.steps):
        for name in SMOOTHED:
            named[name] = width
        if pushes is not None:
            named["external_torque"] = pushes[i]
        middle = start[i] + 0.5 * h * slope[i]
        k1 = system.derivative(state, start[i], named)
        k2 = system.derivative(state + 0.5 * h * k1, middle, named)
        k3 = system.derivative(state + 0.5 * h * k2, middle, named)
        k4 = system.derivative(state + h * k3, start[i] + h * slope[i], named)
        state = state + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        states[i + 1], left[i], right[i] = state, k1, k4
        width = (CROSSING * h * k4[..., -1].abs()).clamp_min(SHARPEST)
    return states, left, right


def predict(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    initial: Tensor,
    push: Tensor | None = None,
    delays: Mapping[int, Tensor] | None = None,
) -> Tensor:
    """Noise-free measurements (L, W, N, M) at the windows' own time stamps.

    Between the integration nodes the state follows the cubic through its values and derivatives. The
    derivative at a step's end is the last stage of the step, since a command may jump at the node.

    Args:
        system, windows, parameters, initial, push: As for :func:`trajectories`, with its source.
        delays: Channel -> (L,) time [s] that its measurements lag behind their stamps. Samples stamped
            earlier after the window's start than that are extrapolated: leave them out of the windows.
    """
    states, left, right = trajectories(system, windows, parameters, initial, push)
    per_sample = {n: v[:, None, None] if v.ndim else v for n, v in parameters.items()}
    lanes, count, channels, samples = initial.shape[0], len(windows), windows.t.shape[1], windows.t.shape[2]
    result = torch.empty(lanes, count, channels, samples, dtype=torch.float64)
    measured: Tensor | None = None
    stamped = 0  # channel at whose stamps `measured` is
    for c in range(channels):
        if delays is not None and c in delays:
            at = windows.t[:, c] - delays[c][:, None, None]
            state = _between_each(states, left, right, at, windows.step)
            result[:, :, c] = system.measure(state, per_sample)[..., c]
            continue
        if measured is None or not torch.equal(windows.t[:, c], windows.t[:, stamped]):
            stamped = c
            state = _between(states, left, right, windows.t[:, c], windows.step)
            measured = system.measure(state, per_sample)
        result[:, :, c] = measured[..., c]
    return result


def _between(states: Tensor, left: Tensor, right: Tensor, t: Tensor, h: float) -> Tensor:
    """Hermite interpolation: states (n + 1, L, W, S) at times t (W, M) -> (L, W, M, S)."""
    cell = (t / h).floor().long().clamp(0, left.shape[0] - 1)
    s = (t / h - cell)[..., None, None]
    window = torch.arange(t.shape[0])[:, None]
    x0, x1 = states[cell, :, window], states[cell + 1, :, window]  # (W, M, L, S)
    d0, d1 = left[cell, :, window] * h, right[cell, :, window] * h
    value = x0 + s * (d0 + s * (3.0 * (x1 - x0) - 2.0 * d0 - d1 + s * (2.0 * (x0 - x1) + d0 + d1)))
    return value.permute(2, 0, 1, 3)


def _between_each(states: Tensor, left: Tensor, right: Tensor, t: Tensor, h: float) -> Tensor:
    """As :func:`_between`, at times t (L, W, M) of each lane's own -> (L, W, M, S)."""
    cell = (t / h).floor().long().clamp(0, left.shape[0] - 1)
    s = (t / h - cell)[..., None]
    lane = torch.arange(t.shape[0])[:, None, None]
    window = torch.arange(t.shape[1])[None, :, None]
    x0, x1 = states[cell, lane, window], states[cell + 1, lane, window]
    d0, d1 = left[cell, lane, window] * h, right[cell, lane, window] * h
    return x0 + s * (d0 + s * (3.0 * (x1 - x0) - 2.0 * d0 - d1 + s * (2.0 * (x0 - x1) + d0 + d1)))

"""Tests of the noise causes, which change the scatter of the measurements and not their mean.

Each test is a likelihood ratio of the final residuals: under white noise of constant size, and under the noise of the
cause. At the null value of the cause's parameter, both are the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.logs.quantum import quantum_of
from deepkoco.systems import System

SPEC = 0.15  # relative uncertainty of the noise in a data sheet
USUAL_JITTER = 1e-4  # of the stamps of a healthy log that a computer's clock stamps [s]
FLOORS = np.geomspace(1e-3, 1.0, 60)  # share of a channel's variance that jitter does not explain
COARSE = 1.0 + 2.0 * SPEC  # error of rounding, over the noise of the data sheet, from which rounding is named
ROUNDED = 1.0 + 1e-6  # of a step that is known from values, over itself as someone stated it
GRID_CHANCE = 0.1  # chance that one sample of a continuous channel lies within 5 % of a grid line


class Scatter(NamedTuple):
    """What the tests use.

    Attributes:
        system: The system.
        windows: The windows.
        fit: The final fit on them.
        floor: Variance that the windows count as noise, over that of the sensors: model error of a healthy unit.
    """

    system: System
    windows: Windows
    fit: Fit
    floor: float = 1.0


class Verdict(NamedTuple):
    """Result of a test: fall of minus twice the log likelihood, and the parameter with its 95 % interval."""

    likelihood_ratio: float
    parameter: str
    value: float
    low: float
    high: float


def jitter(view: Scatter, _: int) -> Verdict | None:
    """Test for time stamps with standard deviation tau: the variance of a channel grows by (tau times its rate)^2.

    The null hypothesis is the jitter of a usual computer clock, not none.
    """
    pieces = []
    for c in range(view.windows.valid.shape[1]):
        residual, slope = residual_and_slope(view.windows, view.fit, c)
        if len(residual) > 40:
            pieces.append((residual, slope))
    if not pieces:
        return None
    largest = max(float(np.sqrt((slope**2).mean())) for _, slope in pieces)
    if not largest > 0.0:
        return None
    # The grid covers jitter whose standard deviation moves a typical sample by 0.03 to 30 noise standard deviations,
    # or by what the residuals show.
    shown = max(float(np.sqrt((residual**2).mean())) for residual, _ in pieces)
    grid = np.geomspace(0.03, max(30.0, 3.0 * shown), 24) / largest
    ratio = np.array([_heteroscedastic(pieces, tau) for tau in grid])
    near = grid[max(int(ratio.argmax()) - 1, 0)], grid[min(int(ratio.argmax()) + 1, len(grid) - 1)]
    grid = np.geomspace(*near, 80)
    ratio = np.array([_heteroscedastic(pieces, tau) for tau in grid])
    best = int(ratio.argmax())
    if not ratio[best] > 0.0 or grid[best] <= USUAL_JITTER:
        return None
    inside = grid[ratio > ratio[best] - 3.84]
    usual = max(_heteroscedastic(pieces, USUAL_JITTER), 0.0)
    return Verdict(
        float(ratio[best]) - usual, "sd", float(grid[best]), float(inside.min()), float(inside.max())
    )


def noise_level(view: Scatter, channel: int) -> Verdict | None:
    """Test whether the noise of a channel exceeds that of its data sheet."""
    declared, found = view.system.measurements[channel].noise_sd, view.windows.noise[channel]
    if not declared > 0.0 or not bool(view.windows.valid[:, channel].any()):
        return None
    # If the channel has a wrong unit, its noise has the same wrong unit.
    slip = view.fit.values.get(f"channel_slip({view.system.measurements[channel].name}).factor", 1.0)
    factor = found.sensor_sd / (declared * abs(slip) * math.sqrt(view.floor))
    if factor <= 1.0 or _grid(view, channel) > ROUNDED * declared * abs(slip):
        return None
    spread = math.hypot(SPEC, found.relative_sd)
    reach = math.exp(1.96 * found.relative_sd)
    ratio = (math.log(factor) / spread) ** 2
    return Verdict(ratio, "factor", factor, factor / reach, factor * reach)


def quantisation(view: Scatter, channel: int) -> Verdict | None:
    """Test whether the values of a channel lie on a grid whose error exceeds the noise of its data sheet.

    Every encoder has a grid. Its rounding errors have the standard deviation step / sqrt(12), and the noise of a data
    sheet contains them.
    """
    declared, step = view.system.measurements[channel].noise_sd, _grid(view, channel)
    if not step / math.sqrt(12.0) > COARSE * declared:
        return None
    samples = int(view.windows.valid[:, channel].sum())
    return Verdict(-2.0 * samples * math.log(GRID_CHANCE), "step", step, step, step)


def _grid(view: Scatter, channel: int) -> float:
    valid = view.windows.valid[:, channel]
    return quantum_of(view.windows.value[:, channel][valid].numpy())


def residual_and_slope(windows: Windows, fit: Fit, c: int) -> tuple[np.ndarray, np.ndarray]:
    """Return whitened residuals of a channel and its whitened rate of change [1/s], from windows with five samples."""
    sd = windows.noise[c].sd
    # Stamps that are known to scatter are part of the noise of the fit; the test asks how much they scatter.
    whole = fit.residual * (windows.sample_sd / sd)
    residuals, slopes = [], []
    for w in range(len(windows)):
        n = int(windows.valid[w, c].sum())
        if n < 5:
            continue
        t = windows.t[w, c, :n].numpy()
        residual = whole[w, c, :n].numpy()
        shown = windows.value[w, c, :n].numpy() / sd - residual
        residuals.append(residual)
        slopes.append(np.gradient(shown, t))
    if not residuals:
        return np.zeros(0), np.zeros(0)
    return np.concatenate(residuals), np.concatenate(slopes)


def _heteroscedastic(pieces: list[tuple[np.ndarray, np.ndarray]], tau: float) -> float:
    """Return the likelihood ratio of the variances a_c + (tau slope)^2, with the best a_c of each channel."""
    total = 0.0
    for residual, slope in pieces:
        square = residual**2
        before = len(square) * (math.log(square.mean()) + 1.0)
        variance = FLOORS[:, None] * square.mean() + (tau * slope) ** 2
        total += before - float((np.log(variance) + square / variance).sum(1).min())
    return total

"""What the extension is worth on data that no fit has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from deepkoco.identify.fit import Fit, FitProblem
from deepkoco.identify.windows import Windows
from deepkoco.systems import ExtendedSystem

RESAMPLES = 2000
BINS = 20  # of the error-by-horizon curve


@dataclass(frozen=True)
class ChannelGain:
    """Root mean square simulation error of one channel over the held-out windows, in its unit."""

    name: str
    unit: str
    baseline: float
    refit: float
    extended: float


@dataclass(frozen=True)
class Gain:
    """Held-out simulation error of three models.

    The initial state of each window (and each log's encoder zero) is fitted on the window itself, for
    every model alike; parameters are those of the training windows.

    Attributes:
        channels: Errors by channel.
        reduction: 1 - extended / refit of the first channel.
        low: Lower end of its 95 % interval, bootstrap over windows.
        high: Upper end.
        windows: Number of held-out windows.
        horizon: Length of a window [s].
        curve_time: (BINS,) time since the window's start [s].
        curves: model -> channel -> (BINS,) error by time.
        replayed: The held-out windows.
        fits: model -> fit on the held-out windows.
    """

    channels: tuple[ChannelGain, ...]
    reduction: float
    low: float
    high: float
    windows: int
    horizon: float
    curve_time: np.ndarray
    curves: dict[str, dict[str, np.ndarray]]
    replayed: Windows
    fits: dict[str, Fit]


def held_out_gain(
    system: ExtendedSystem, windows: Windows, models: Mapping[str, Mapping[str, float]], seed: int
) -> Gain:
    """Simulate held-out windows with each model.

    Args:
        system: The system with every effect.
        windows: Held-out windows.
        models: "baseline", "refit" and "extended" -> parameter values.
        seed: Seed of the bootstrap.
    """
    problem = FitProblem(system, windows)
    fits: dict[str, Fit] = {}
    for name, values in models.items():
        same = next((other for other in fits if models[other] == values), None)
        before = next(reversed(fits.values())).state if fits else None
        fits[name] = fits[same] if same else problem.evaluate(values, name, before)
    sd = torch.tensor([n.sd for n in windows.noise], dtype=torch.float64)
    error = {name: (fit.residual * sd[:, None]).numpy() for name, fit in fits.items()}
    valid = windows.valid.numpy()
    channels = []
    for c, channel in enumerate(system.measurements):
        if valid[:, c].any():
            rms = {name: _rms(e[:, c], valid[:, c]) for name, e in error.items()}
            channels.append(
                ChannelGain(channel.name, channel.unit, rms["baseline"], rms["refit"], rms["extended"])
            )
    first = next(c for c in range(valid.shape[1]) if valid[:, c].any())
    square = {name: (e[:, first] ** 2).sum(1) for name, e in error.items()}
    rng = np.random.default_rng(seed)
    picks = rng.integers(0, len(windows), (RESAMPLES, len(windows)))
    ratio = np.sqrt(square["extended"][picks].sum(1) / square["refit"][picks].sum(1).clip(1e-300))
    low, high = np.quantile(1.0 - ratio, [0.025, 0.975])
    edges = np.linspace(0.0, windows.length, BINS + 1)
    t = windows.t.numpy()
    curves: dict[str, dict[str, np.ndarray]] = {}
    for name, e in error.items():
        curves[name] = {}
        for c, channel in enumerate(system.measurements):
            if valid[:, c].any():
                inside = [valid[:, c] & (t[:, c] >= a) & (t[:, c] < b) for a, b in pairwise(edges)]
                curves[name][channel.name] = np.array([_rms(e[:, c], m) for m in inside])
    return Gain(
        tuple(channels),
        1.0 - channels[0].extended / max(channels[0].refit, 1e-300),
        float(low),
        float(high),
        len(windows),
        windows.length,
        0.5 * (edges[:-1] + edges[1:]),
        curves,
        windows,
        fits,
    )


def _rms(error: np.ndarray, valid: np.ndarray) -> float:
    return float(np.sqrt((error[valid] ** 2).mean())) if valid.any() else float("nan")

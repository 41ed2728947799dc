"""Where a joint rests."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from deepkoco.fit.data.noise import Noise
from deepkoco.systems import System
from deepkoco.systems.engine_names import MUJOCO

DWELL = 0.1  # share of a window over which rest is tested
REST = 5.0  # peak-to-peak motion, in noise standard deviations, below which a joint rests for that time


def _rest_stamps(t: np.ndarray, value: np.ndarray, seconds: float, reach: float) -> np.ndarray:
    """Stamps of samples in stretches of ``seconds`` whose values span less than ``reach``."""
    count = max(4, math.ceil(seconds * (len(t) - 1) / max(t[-1] - t[0], 1e-9)))
    if len(t) < count:
        return np.zeros(0)
    runs = np.lib.stride_tricks.sliding_window_view(value, count)
    begins = np.flatnonzero(runs.max(-1) - runs.min(-1) < reach)
    return t[np.unique(begins[:, None] + np.arange(count))]


def resting_stamps(
    system: System,
    series: Mapping[str, tuple[np.ndarray, np.ndarray]],
    noise: tuple[Noise, ...],
    length: float,
) -> np.ndarray | None:
    """Stamps at which a joint rests; None without dry friction or without a measured position.

    A joint whose friction creeps never rests: a simulation follows it there, too.
    """
    if not system.dry_friction or system.engine == MUJOCO:
        return None
    found = []
    for channel, state, own in zip(system.measurements, system.measured_states, noise, strict=True):
        if state < system.joints and channel.name in series:
            found.append(_rest_stamps(*series[channel.name], DWELL * length, REST * own.sd))
    return np.concatenate(found) if found else None

"""The most likely commands of a log whose rows hold noise that no motor felt.

The rough part of a logged command tells of such noise: a command that acted is smooth next to white noise of a sensor.
With the spectrum S of the log, and the spectrum c by which noise and log go together, the most likely noise is the log
behind the filter c / S of no phase: most of what is rough, and next to nothing where the command has power. The noise
that stays is independent of the commands that are left, so no fit gains by damping them. With noise still in the
commands, a weaker drive or a lag would seem to explain a log. Sources: Wiener, Extrapolation, Interpolation, and
Smoothing of Stationary Time Series (1949); Carroll et al., Measurement Error in Nonlinear Models (2006), on regression
calibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import oaconvolve, welch

from deepkoco.fit.data.series import CommandSeries

SEGMENT, SHORTEST = 256, 32  # commands whose spectrum is taken
SEGMENTS = 4  # of them at least that show a spectrum


def likely_commands(command: CommandSeries, logged: Sequence[float]) -> CommandSeries:
    """Return the most likely commands of a log.

    Args:
        command: As logged.
        logged: Square root of the covariance of the noise of each command that no motor felt with the logged command,
            as independent noise of each row, in its unit; 0 where the log does not hold the noise.
    """
    value = np.array(command.value, dtype=float)
    for index, told in enumerate(logged):
        column = value if value.ndim == 1 else value[:, index]
        changes = np.append(0, np.flatnonzero(np.diff(column) != 0.0) + 1)
        segment = min(len(changes) // SEGMENTS, SEGMENT) // 2 * 2
        if told == 0.0 or segment < SHORTEST:
            continue
        # Rows that repeat a command repeat its noise.
        held = max(float(np.median(np.diff(changes))), 1.0)
        likely = column[changes] - _noise(column[changes], told**2 / held, segment)
        column[:] = np.repeat(likely, np.diff(np.append(changes, len(column))))
    return replace(command, value=value)


def _noise(value: np.ndarray, covariance: float, segment: int) -> np.ndarray:
    """Return the most likely noise in values, by spectra of segments."""
    _, power = welch(value, nperseg=segment, detrend="linear")
    share = 2.0 * covariance / np.maximum(power, 2.0 * covariance)
    share[:2] = 0.0  # the segments have no mean and no slope
    response = np.fft.irfft(share)[: len(share) - 1]
    # Values go on beyond their ends as they came, turned by half a circle.
    wide = len(response) - 1
    before, after = 2.0 * value[0] - value[wide:0:-1], 2.0 * value[-1] - value[-2 : -wide - 2 : -1]
    both = np.concatenate([response[:0:-1], response])
    return oaconvolve(np.concatenate([before, value, after]), both, mode="valid")

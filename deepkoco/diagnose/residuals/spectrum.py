"""Spectrum of the missing load: its strongest line."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lombscargle

from deepkoco.diagnose.residuals.residuals import MissingTorque

MIN_FREQUENCIES = 400  # in the periodogram
OVERSAMPLING = (
    4.0  # frequencies for each independent one; a line between two of them loses at most a tenth of its power
)


def spectrum_of(missing: Sequence[MissingTorque]) -> dict[str, float]:
    """Return the strongest line of the missing load, at the joint whose load is largest against its uncertainty.

    Windows have gaps between them, so the Lomb-Scargle periodogram is used. It ranges from one period in the whole
    log to one period in four slots.

    Returns:
        ``peak_rad_s``; ``peak_share``, the share of the power that a sine of this frequency explains (0 to 1); and
        ``chance_share``, which white noise in the same number of slots exceeds with probability 1 %.

    Source: Scargle, Astrophysical Journal 263, 1982; ``chance_share`` from the maximum of independent exponentials.
    """
    loudest = max(missing, key=lambda m: float(((m.torque / m.sd) ** 2).mean()))
    # Each log has its own clock, so only the log with the most windows is used.
    log = int(np.bincount(loudest.log).argmax())
    own = loudest.log == log
    time, load = loudest.time[own].ravel(), loudest.torque[own].ravel()
    load = load - load.mean()
    length = float(np.ptp(time))
    if length <= 0.0 or not bool(np.ptp(load) > 0.0):
        return {"peak_rad_s": 0.0, "peak_share": 0.0, "chance_share": 1.0}
    low, high = 2.0 * math.pi / length, 0.5 * math.pi / loudest.slot
    apart = max((high - low) / low, 1.0)  # independent frequencies
    frequency = np.linspace(low, high, max(MIN_FREQUENCIES, math.ceil(OVERSAMPLING * apart)))
    share = lombscargle(time, load, frequency, normalize=True)
    best = int(np.argmax(share))
    independent = max(apart, len(load) / 2)
    chance = 1.0 - (1.0 - 0.99 ** (1.0 / independent)) ** (2.0 / max(len(load) - 3, 1))
    return {
        "peak_rad_s": float(frequency[best]),
        "peak_share": float(share[best]),
        "chance_share": float(chance),
    }

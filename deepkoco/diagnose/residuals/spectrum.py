"""At which frequency a missing load comes back, if at any."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lombscargle

from deepkoco.diagnose.residuals.residuals import MissingTorque

MIN_FREQUENCIES = 400  # frequencies
OVERSAMPLING = (
    4.0  # frequencies for each that is independent: a line between two of them loses a tenth at most
)


def spectrum_of(missing: Sequence[MissingTorque]) -> dict[str, float]:
    """Strongest line of the load at the joint where most is missing.

    Windows lie apart and slots may be left out, so the periodogram is that of Lomb and Scargle, from one period in the
    whole log to one in four slots.

    Returns:
        ``peak_rad_s``; ``peak_share``, the part of the power that a sine of this frequency takes away (0 to 1); and
        ``chance_share``, which white noise of as many slots exceeds once in a hundred.

    Source: Scargle, Astrophysical Journal 263, 1982; the level of chance from the maximum of independent exponentials.
    """
    loudest = max(missing, key=lambda m: float(((m.torque / m.sd) ** 2).mean()))
    # Logs have clocks of their own: a line is looked for in the longest one.
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

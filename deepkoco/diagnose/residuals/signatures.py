"""Signatures of the residuals: statistics for the reader that do not change the verdict.

They describe the residuals also where no cause is named: scattered time stamps, repeated readings, values on a grid.
Lost commands leave no such signature; :mod:`deepkoco.diagnose.lost_commands.search` searches for them tick by tick.
"""

from __future__ import annotations

import math

import numpy as np

from deepkoco.diagnose.diagnosis import Evidence
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.diagnose.residuals.scatter import USUAL_JITTER, residual_and_slope
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.logs.quantum import quantum_of
from deepkoco.systems import System

CHANCE = 5.0  # limit of a correlation by chance, in standard deviations of unrelated samples
MIN_SAMPLES = 40  # samples that a correlation needs
REPEATED = 0.005  # share of repeated readings from which they are reported
COARSE = 1.0  # step of a grid, in noise standard deviations of the channel, from which it is reported


def signatures(system: System, windows: Windows, fit: Fit) -> tuple[Evidence, ...]:
    """Return the signatures whose statistic exceeds its threshold.

    Args:
        system: System that names the channels.
        windows: Training windows.
        fit: The final model on them.
    """
    found: list[Evidence | None] = []
    for c, channel in enumerate(system.measurements):
        if bool(windows.valid[:, c].any()):
            repeated = repeated_readings(windows, c, channel.name)
            # Repeated readings are older than their stamps. Their errors also grow with the rate, even if the stamps
            # are regular, so scattered stamps are not tested then.
            scattered = scattered_stamps(windows, fit, c, channel.name) if repeated is None else None
            found += [
                moved_stamps(windows, c, channel.name),
                scattered,
                repeated,
                value_grid(windows, c, channel.name, channel.unit),
            ]
    return tuple(e for e in found if e is not None)


def scattered_stamps(windows: Windows, fit: Fit, index: int, name: str) -> Evidence | None:
    """Test whether the squared residuals of a channel grow with its squared rate while the residuals are white."""
    residual, slope = residual_and_slope(windows, fit, index)
    limit = CHANCE / math.sqrt(max(len(residual), 1))
    if len(residual) < MIN_SAMPLES or dispersion(fit, windows).lag_one > 5.0 / math.sqrt(windows.samples):
        return None
    found = _correlation(residual**2, slope**2)
    if not found > limit:
        return None
    text = (
        f"The time stamps of {name} scatter: its squared errors grow with its squared rate of change (correlation "
        f"{found:.2f}; chance stays within {limit:.2f}), and neighbouring errors are not correlated."
    )
    return Evidence("scattered_stamps", found, limit, text)


def moved_stamps(windows: Windows, index: int, name: str) -> Evidence | None:
    """Say that stamps scattered about even times, at which the motion shows that the samples were taken."""
    scatter = windows.taken_out[index] if windows.taken_out else 0.0
    if not scatter > USUAL_JITTER:
        return None
    text = (
        f"The time stamps of {name} scatter by {1e3 * scatter:.2g} ms. Its motion is smooth only at even times, so the "
        "log was read at these, and no cause has to explain the scatter. Stamp samples where they are taken."
    )
    return Evidence("moved_stamps", scatter, USUAL_JITTER, text)


def repeated_readings(windows: Windows, index: int, name: str) -> Evidence | None:
    """Test whether readings repeat the previous one to the last digit although the values lie on no grid."""
    value, valid = windows.value[:, index].numpy(), windows.valid[:, index].numpy()
    pairs = valid[:, 1:] & valid[:, :-1]
    if pairs.sum() < MIN_SAMPLES or quantum_of(value[valid]) > 0.0:
        return None
    same = (value[:, 1:] == value[:, :-1])[pairs]
    share = float(same.mean())
    if not (share > REPEATED and same.sum() >= 5):
        return None
    text = (
        f"{100 * share:.1f} % of the readings of {name} repeat the previous one to the last digit, which noise would "
        "prevent. Possible reasons: the sensor is slower than the log, it clips, or readings were lost and replaced "
        "by the previous one."
    )
    return Evidence("repeated_readings", share, REPEATED, text)


def value_grid(windows: Windows, index: int, name: str, unit: str) -> Evidence | None:
    """Test whether all values lie on a grid whose step is larger than the noise."""
    step = quantum_of(windows.value[:, index][windows.valid[:, index]].numpy())
    found = step / windows.noise[index].sd
    if not found > COARSE:
        return None
    text = (
        f"{name} is rounded: all its values lie on a grid of {step:.3g} {unit}, {found:.1f} times its noise."
    )
    return Evidence("value_grid", found, COARSE, text)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) > 0.0 and np.ptp(b) > 0.0 else 0.0

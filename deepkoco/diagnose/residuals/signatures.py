"""Signatures of timing and of sensors in what a model leaves: evidence for a reader, no verdict.

A cause of the catalogue is named by its likelihood. These statistics say what the residuals look like, also where
nothing is named: stamps that scatter, readings that repeat, values on a grid. (Lost commands leave no such mark; they
are searched for tick by tick: deepkoco.diagnose.lost_commands.search.)
"""

from __future__ import annotations

import math

import numpy as np

from deepkoco.diagnose.diagnosis import Evidence
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.diagnose.residuals.scatter import residual_and_slope
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.logs.quantum import quantum_of
from deepkoco.systems import System

CHANCE = 5.0  # standard deviations of a correlation of unrelated samples
MIN_SAMPLES = 40  # samples that a correlation needs
REPEATED = 0.005  # share of readings that repeat the one before, from which it is worth telling
COARSE = 1.0  # noises of the channel that a step of a grid must reach


def signatures(system: System, windows: Windows, fit: Fit) -> tuple[Evidence, ...]:
    """The signatures that hold.

    Args:
        system: Names the channels.
        windows: Training windows.
        fit: The final model on them.
    """
    found: list[Evidence | None] = []
    for c, channel in enumerate(system.measurements):
        if bool(windows.valid[:, c].any()):
            repeated = repeated_readings(windows, c, channel.name)
            # A reading that is older than its stamp errs with the rate, too, however regular the stamps are.
            scattered = scattered_stamps(windows, fit, c, channel.name) if repeated is None else None
            found += [scattered, repeated, value_grid(windows, c, channel.name, channel.unit)]
    return tuple(e for e in found if e is not None)


def scattered_stamps(windows: Windows, fit: Fit, index: int, name: str) -> Evidence | None:
    """Squared residuals that grow with the squared rate of a channel, while the residuals are white."""
    residual, slope = residual_and_slope(windows, fit, index)
    limit = CHANCE / math.sqrt(max(len(residual), 1))
    if len(residual) < MIN_SAMPLES or dispersion(fit, windows).lag_one > 5.0 / math.sqrt(windows.samples):
        return None
    found = _correlation(residual**2, slope**2)
    if not found > limit:
        return None
    text = (
        f"Squared errors of {name} grow with its squared rate of change (correlation {found:.2f}; chance stays within "
        f"{limit:.2f}) while neighbouring errors are not alike: its time stamps scatter."
    )
    return Evidence("scattered_stamps", found, limit, text)


def repeated_readings(windows: Windows, index: int, name: str) -> Evidence | None:
    """Readings that are the same as the one before to the last digit, where values lie on no grid."""
    value, valid = windows.value[:, index].numpy(), windows.valid[:, index].numpy()
    pairs = valid[:, 1:] & valid[:, :-1]
    if pairs.sum() < MIN_SAMPLES or quantum_of(value[valid]) > 0.0:
        return None
    same = (value[:, 1:] == value[:, :-1])[pairs]
    share = float(same.mean())
    if not (share > REPEATED and same.sum() >= 5):
        return None
    text = (
        f"{100 * share:.1f} % of the readings of {name} repeat the one before to the last digit (noise lets none): "
        "readings are held (the sensor is slower than the log), clipped, or lost and the last one written again."
    )
    return Evidence("repeated_readings", share, REPEATED, text)


def value_grid(windows: Windows, index: int, name: str, unit: str) -> Evidence | None:
    """Values that all lie on a grid whose steps show against the noise."""
    step = quantum_of(windows.value[:, index][windows.valid[:, index]].numpy())
    found = step / windows.noise[index].sd
    if not found > COARSE:
        return None
    text = f"All values of {name} lie on a grid of {step:.3g} {unit}, {found:.1f} times its noise: it is rounded."
    return Evidence("value_grid", found, COARSE, text)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) > 0.0 and np.ptp(b) > 0.0 else 0.0

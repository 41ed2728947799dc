"""Test whether only noise is left: flexible causes are named only if it is."""

from __future__ import annotations

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.residuals.residuals import coloured_from
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.dispersion import dispersion

MAX_SD = 2.0  # standard deviations of the chi2 and the correlation of noise


def more_than_noise(fit: Fit, windows: Windows, start: Baseline) -> str | None:
    """Return in words how the residuals of a fit exceed noise; None if only noise is left.

    Args:
        fit: The fit.
        windows: Its windows.
        start: The baseline, whose healthy logs give floor and correlation of the unit when nothing is wrong.
    """
    chi2, most = fit.chi2 / windows.samples, start.most_noise(windows, MAX_SD)
    if chi2 > most:
        return f"chi2 per sample is {chi2:.3g} (noise: up to {most:.3g})"
    lag_one, alike = (
        dispersion(fit, windows).lag_one,
        coloured_from(windows, MAX_SD) + start.healthy_lag_one,
    )
    if lag_one > alike:
        return f"the correlation of neighbouring residuals is {lag_one:.2g} (noise: up to {alike:.2g})"
    return None

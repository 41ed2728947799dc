"""Whether a fit leaves noise: what bends to anything is believed only if nothing else is left."""

from __future__ import annotations

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.residuals.residuals import coloured_from, white_limit
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.dispersion import dispersion

DOUBTFUL = 2.0  # standard deviations of noise's own chi2 and correlation


def more_than_noise(fit: Fit, windows: Windows, start: Baseline) -> str | None:
    """What a fit leaves that noise has not, as a clause of a sentence; None where it leaves noise.

    Args:
        fit: The fit.
        windows: Its windows.
        start: The baseline, whose healthy logs tell what is left of a unit in which nothing is wrong.
    """
    chi2, most = fit.chi2 / windows.samples, white_limit(windows, DOUBTFUL) * start.floor
    if chi2 > most:
        return f"chi2 per sample is {chi2:.3g}, where noise leaves up to {most:.3g}"
    lag_one, alike = (
        dispersion(fit, windows).lag_one,
        coloured_from(windows, DOUBTFUL) + start.healthy_lag_one,
    )
    if lag_one > alike:
        return (
            f"neighbouring residuals have a correlation of {lag_one:.2g}, where noise has up to {alike:.2g}"
        )
    return None

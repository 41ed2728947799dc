"""Weights of windows that are much worse than the others: contact with a table, a blocked joint, a hand on the arm.

Least squares lets two windows of forty, whose squared error is a hundred times that of the others, decide all
parameters. Where the simulation is far from its log anyway, the error of a channel in a window is therefore taken to
follow a t distribution: it has a size of its own, around one that is typical of the channel. Channels differ in what is
typical, too: a joint whose gear the model knows poorly must not hide what another joint shows clearly.

Source: Lange, Little and Taylor, Robust statistical modeling using the t distribution (1989): maximum likelihood by
    repeated weighting, four degrees of freedom. Bard, Nonlinear parameter estimation (1974), ch. 4: unknown variance of
    each channel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit_types import Fit
from deepkoco.fit.solve.dispersion import dispersion

DEGREES = 4.0
STEPS = 50  # of the search for the typical error of a channel
SETTLED = 1e-6


def with_doubt(windows: Windows, fit: Fit) -> Windows:
    """Return windows whose noise is larger where a fit is much worse than is typical of the channel.

    Args:
        windows: The windows.
        fit: A fit of them, perhaps under other doubts.
    """
    plain = replace(windows, doubt=None)
    raw = undoubted(windows, fit)
    samples = windows.valid.sum(-1).numpy()
    error = (raw.square().sum(-1) / windows.valid.sum(-1).clamp_min(1)).numpy()
    independent = samples / dispersion(replace(fit, residual=raw), plain).correlation
    found = [weights(e, n) for e, n in zip(error.T, independent.T, strict=True)]
    weight = np.minimum(np.stack([own for own, _ in found], -1), 1.0)
    typical = np.array([level for _, level in found])
    typical[typical == 0.0] = least = typical[typical > 0.0].min(initial=np.inf)
    # Noise variances stay the unit of the channel that is simulated best.
    share = np.maximum(typical, 1.0) / max(least, 1.0) if np.isfinite(least) else np.ones(len(typical))
    return replace(windows, doubt=torch.from_numpy(np.sqrt(share / weight)))


def under(windows: Windows, fit: Fit, before: Windows) -> Fit:
    """Return a fit with its residuals in the noise of the same windows with other noise or doubts.

    Args:
        windows: The windows whose noise counts.
        fit: The fit.
        before: Windows in whose noise its residuals are.
    """
    return replace(fit, residual=fit.residual * before.sample_sd / windows.sample_sd)


def undoubted(windows: Windows, fit: Fit) -> Tensor:
    """Return the residuals (W, N, M) of a fit in units of the noise alone."""
    return fit.residual * windows.sample_sd / replace(windows, doubt=None).sample_sd


def weights(error: np.ndarray, independent: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the weight (W,) of each window under a t distribution of one channel's errors, and their typical size.

    Args:
        error: (W,) mean squared error of each window [noise variances].
        independent: (W,) independent samples of each window; 0 for one without samples.

    Returns:
        The weights, and the typical mean squared error [noise variances]; 0 for a channel without samples or errors.
    """
    shown = independent > 0.0
    if not shown.any() or not error[shown].any():
        return np.ones(len(error)), 0.0
    count = independent[shown]
    typical, weight = float(np.median(error[shown])) or float(error[shown].mean()), np.ones(len(error))
    for _ in range(STEPS):
        weight[shown] = (DEGREES + count) / (DEGREES + count * error[shown] / typical)
        found = float((weight[shown] * count * error[shown]).sum() / count.sum())
        settled = abs(found - typical) <= SETTLED * typical
        typical = found
        if settled:
            break
    return weight, typical

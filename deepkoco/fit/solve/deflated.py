"""Covariance of estimates whose residuals are correlated, beside a prior that is none of them."""

from __future__ import annotations

import numpy as np

from deepkoco.fit.fit_types import Fit


def deflated(fit: Fit, deflation: float, narrowed: float) -> np.ndarray:
    """Return the covariance (p, p) of the estimates of a fit as it was made, with correlated residuals.

    The fit minimises chi2 plus the penalty of a prior. Its estimates move with the noise by C g, where C = (I + P)^-1
    is the inverse of the information I of the data plus the precision P of the prior, and g is the slope of chi2. For
    independent residuals the covariance of g is I. For correlated ones it is D I, with the deflation D. A prior's
    statement is one draw, whatever the residuals do: it moves the estimates by C P x, with the covariance P^-1 of x.
    Where the fit has narrowed it by n, the covariance of x is n P^-1. Together

        C (D I + n P) C = n C + (D - n) C I C.

    It is D C where the data determine everything and where the prior counts as much as the residuals do (n = D). It
    is n C, the prior as it was stated, where the data tell nothing.

    Args:
        fit: The fit, with its covariance C and the information I.
        deflation: D, times by which independent residuals are fewer, and larger than noise.
        narrowed: n, factor by which the prior of the fit is narrower, as a variance, than it was stated; what is
            above the deflation counts as the deflation.

    Source: White, Maximum likelihood estimation of misspecified models, Econometrica 50(1), 1982 (the sandwich).
    """
    n = min(narrowed, deflation)
    if n == deflation or not fit.free:
        return fit.covariance * deflation
    size = np.sqrt(np.maximum(fit.covariance.diagonal(), 1e-300))
    # In units of the estimates' own deviations, so that nothing is lost between kilograms and radians.
    scale = np.outer(size, size)
    known = fit.covariance / scale
    moved = known @ (fit.information * scale) @ known
    # C I C lies between 0 and C; rounding may take it out of there where estimates are nearly the same direction.
    share = np.clip(moved.diagonal(), 0.0, known.diagonal()) / np.maximum(moved.diagonal(), 1e-300)
    root = np.sqrt(share)
    return (n * known + (deflation - n) * 0.5 * (moved + moved.T) * np.outer(root, root)) * scale

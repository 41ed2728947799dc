"""Uncertainty of sizes that the logs tell only as ratios: that of the scale gauges which a fit keeps as given."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.fit.fit import Fit

FREED = 2.0  # times its prior variance, above which a fit does not keep a parameter


def scale_covariance(start: Baseline) -> np.ndarray:
    """Return the relative covariance (K, K) of the K scales that the gauges of a baseline leave open.

    A scale c multiplies each member n of its gauge by c^e_n. The data say nothing of it, so what is known are the
    declared values v and deviations sd of all members: the precision of log c is the sum of (e_n v_n / sd_n)^2.

    Args:
        start: The baseline; its gauges may share members.
    """
    names = list(dict.fromkeys(n for g in start.gauges for n in g.exponents))
    known = [start.system.parameter(n) for n in names]
    relative = np.array([p.value / p.prior_sd if p.prior_sd > 0.0 else 0.0 for p in known])
    exponents = np.array([[g.exponents.get(n, 0.0) for g in start.gauges] for n in names])
    rows = exponents * relative[:, None]
    return np.linalg.pinv(rows.T @ rows, hermitian=True)


def scale_variance(start: Baseline, fit: Fit) -> dict[str, float]:
    """Return by how much the open scales add to the variance of each free parameter of a fit.

    A fit keeps one member of each gauge as given. Its covariance with another parameter says how this one follows:
    exactly where the data give their ratio, not at all where the data give the parameter itself.

    Args:
        start: The baseline with the gauges.
        fit: A fit on top of it. A fit that frees a kept member as a changed parameter counts it by itself: then the
            result is empty, as it is without a gauge.
    """
    kept = [g.fixed for g in start.gauges]
    if not kept or not set(kept) <= set(fit.free):
        return {}
    index = [fit.free.index(n) for n in kept]
    covariance, prior = fit.covariance, start.prior
    usual = np.array([prior.covariance[i, i] for i in map(prior.names.index, kept)])
    own = np.diag(covariance)[index]
    if not ((own > 0.0) & (own <= FREED * usual)).all():
        return {}
    follows = np.linalg.solve(covariance[np.ix_(index, index)], covariance[index]).T  # (p, K)
    given = np.array([start.values[n] for n in kept])
    scales = scale_covariance(start) * np.outer(given, given)
    return dict(zip(fit.free, np.einsum("pk,kl,pl->p", follows, scales, follows).tolist(), strict=True))

"""Evidence of changes that are freed: normal likelihoods times Cauchy priors, some on one side of a bound only.

The exponent is expanded at its mode, where a coordinate with value d and Cauchy scale w gets the curvature
``2 / (w^2 + d^2)``. Each coordinate's factor is then integrated exactly in one dimension with the others normal. The
result is exact for one coordinate and for independent ones, bounds included.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

STEPS = 40  # of the iteration to the mode
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)
REACH = 9.0  # standard deviations on each side that an integral covers
DECAYS = 40.0  # lengths of decay that an integral beyond a bound covers


class Freed(NamedTuple):
    """Evidence of K sets of k freed coordinates.

    Attributes:
        log_gain: (K,) log evidence minus that without these changes.
        mode: (K, k) most probable values; outside the bounds where the bound cuts them.
        covariance: (K, k, k) around the mode.
    """

    log_gain: np.ndarray
    mode: np.ndarray
    covariance: np.ndarray


def freed(
    information: np.ndarray,
    pull: np.ndarray,
    wide: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    at: np.ndarray | None = None,
) -> Freed:
    """Integrate freed coordinates under Cauchy priors.

    Args:
        information: (K, k, k) of the data about changes.
        pull: (K, k).
        wide: (K, k) Cauchy scales; infinite for a coordinate that only fills the array, with no information.
        low: (K, k) smallest values.
        high: (K, k) largest values.
        at: (K, k) values at which pull is the slope of the log likelihood; None for 0.
    """
    at = np.zeros_like(pull) if at is None else at
    used = np.isfinite(wide)
    scale = np.where(used, wide, 1.0)
    # In units of the scales, so that no unit matters.
    k = information * scale[:, :, None] * scale[:, None, :]
    k = np.where(used[:, :, None] & used[:, None, :], k, 0.0)
    start, right = at / scale, np.where(used, pull * scale, 0.0)
    right = right + (k @ start[..., None])[..., 0]
    eye = np.eye(k.shape[1])
    x = np.zeros_like(right)
    for _ in range(STEPS):
        curve = 2.0 / (1.0 + x**2)
        new = np.linalg.solve(k + curve[:, :, None] * eye, right[..., None])[..., 0]
        settled = np.abs(new - x).max(initial=0.0) < 1e-9
        x = new
        if settled:
            break
    curve = 2.0 / (1.0 + x**2)
    matrix = k + curve[:, :, None] * eye
    covariance = np.linalg.inv(matrix)
    log_prior = -np.log(np.pi * (1.0 + x**2))
    value = (x * right).sum(-1) - 0.5 * np.einsum("ki,kij,kj->k", x, k, x)
    value -= (start * right).sum(-1) - 0.5 * np.einsum("ki,kij,kj->k", start, k, start)
    size = np.where(used, np.log(2.0 * np.pi), 0.0).sum(-1) - np.linalg.slogdet(matrix)[1]
    # A coordinate that fills the array contributes its curvature of 2 and nothing else.
    size = size + np.where(used, 0.0, np.log(2.0)).sum(-1)
    laplace = value + np.where(used, log_prior, 0.0).sum(-1) + 0.5 * size
    spread = np.einsum("kii->ki", covariance)
    alone = np.maximum(1.0 / spread - curve, 1e-9)
    centre = x + curve * x / alone
    exact = log_cauchy_normal(alone, centre, low / scale, high / scale)
    normal = -0.5 * alone * (x - centre) ** 2 + log_prior + 0.5 * np.log(2.0 * np.pi / (alone + curve))
    gain = laplace + np.where(used, exact - normal, 0.0).sum(-1)
    return Freed(gain, x * scale, covariance * scale[:, :, None] * scale[:, None, :])


def log_cauchy_normal(
    precision: np.ndarray, centre: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Return the log of the integral of exp(-precision (x - centre)^2 / 2) under a standard Cauchy prior.

    The prior is restricted to [low, high] and normalised there. All arguments have one shape.
    """
    inside = np.clip(centre, low, high)
    sd = 1.0 / np.sqrt(precision)
    past = np.abs(centre - inside)
    reach = np.minimum(REACH * sd, DECAYS / np.maximum(precision * past, 1e-300))
    # A likelihood that is sharp, or far from the prior's centre, is integrated over x around its own centre; a flat one
    # over the angle of x = tan(angle), in which the prior is constant.
    sharp = (precision > 4.0) | (np.abs(centre) > 4.0 * sd)
    a = np.where(sharp, np.maximum(low, inside - reach), np.arctan(low))
    b = np.where(sharp, np.minimum(high, inside + reach), np.arctan(high))
    half = 0.5 * (b - a)[..., None]
    node = 0.5 * (a + b)[..., None] + half * NODES
    x = np.where(sharp[..., None], node, np.tan(np.clip(node, -1.57079632, 1.57079632)))
    log_density = np.where(sharp[..., None], -np.log(np.pi * (1.0 + x**2)), -np.log(np.pi))
    exponent = -0.5 * precision[..., None] * (x - centre[..., None]) ** 2 + log_density
    top = exponent.max(-1, keepdims=True)
    total = (np.exp(exponent - top) * WEIGHTS * half).sum(-1)
    share = np.maximum((np.arctan(high) - np.arctan(low)) / np.pi, 1e-300)
    return np.log(np.maximum(total, 1e-300)) + top[..., 0] - np.log(share)

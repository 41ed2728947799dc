"""Find combinations of parameters that the data do not identify."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.prior import Prior


@dataclass(frozen=True)
class Direction:
    """A combination of parameters about which the data contain less information than the prior.

    Attributes:
        weights: Parameter -> share in prior standard deviations. Shares below 0.1 are left out.
        information: Information of the data along the combination, relative to the prior's; below 1.
    """

    weights: dict[str, float]
    information: float


def unidentified(fit: Fit, prior: Prior) -> tuple[Direction, ...]:
    """Find the combinations of the free parameters that are not identified.

    They are the eigenvectors of L^T I L with eigenvalues below 1. I is the information of the data with initial states
    eliminated, and L L^T is the covariance of the prior. Along them the prior determines the estimate.
    """
    index = [prior.names.index(n) for n in fit.free]
    if not index:
        return ()
    covariance = prior.covariance[np.ix_(index, index)]
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * vectors * np.sqrt(values.clip(0.0))
    information, directions = np.linalg.eigh(root.T @ fit.information @ root)
    result = []
    for value, direction in zip(information, directions.T, strict=True):
        if value >= 1.0:
            break
        share = (root @ direction) / scale
        share /= np.linalg.norm(share)
        share *= np.sign(share[np.argmax(np.abs(share))])
        kept = {n: float(w) for n, w in zip(fit.free, share, strict=True) if abs(w) > 0.1}
        result.append(Direction(kept, float(max(value, 0.0))))
    return tuple(result)

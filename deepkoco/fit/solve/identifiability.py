"""Which combinations of parameters a log cannot tell apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.prior import Prior


@dataclass(frozen=True)
class Direction:
    """A combination of parameters about which the data say less than the prior.

    Attributes:
        weights: Parameter -> share, in prior standard deviations; squares add up to 1.
        information: Information of the data along it, in units of the prior's; below 1.
    """

    weights: dict[str, float]
    information: float


def unidentified(fit: Fit, prior: Prior) -> tuple[Direction, ...]:
    """Near null space of the Jacobian, in the metric of the prior.

    The eigenvectors of L^T I L, with I the data's information (initial states eliminated) and L L^T the
    prior's covariance, whose eigenvalues are below 1: along them the prior decides, not the log.
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

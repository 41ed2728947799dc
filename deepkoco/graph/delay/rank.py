"""Rank correlation between the channels of one publisher."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepkoco.graph.delay.law import DelayError


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's correlation between delays that one step causes.

    The channels belong to one node: messages on its connections, and its own computation. The delays of
    step k have normal scores with correlation 2 sin(pi rho / 6), rho the rank correlation; the law of each
    channel stays what it is.

    Attributes:
        channels: connection keys, and at most one node name.
        value: rho between all of them, or a (C, C) matrix.

    Source: Kruskal, Ordinal measures of association (1958), for rho of a bivariate normal.
    """

    channels: tuple[str, ...]
    value: float | tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        if isinstance(self.channels, str) or len(set(self.channels)) < 2:
            raise DelayError(f"rank correlation: {self.channels!r} are not two or more different channels")
        object.__setattr__(self, "channels", tuple(self.channels))
        size, name = len(self.channels), " and ".join(self.channels)
        matrix = np.asarray(self.value, dtype=np.float64)
        if matrix.ndim == 0:
            object.__setattr__(self, "value", float(matrix))
            matrix = np.where(np.eye(size, dtype=np.bool_), 1.0, matrix)
        else:
            object.__setattr__(self, "value", tuple(map(tuple, matrix.tolist())))
        if matrix.shape != (size, size) or not (matrix == matrix.T).all() or (np.diag(matrix) != 1).any():
            raise DelayError(f"rank correlation of {name}: expected a symmetric {size} x {size} matrix, ones")
        if not (np.abs(matrix) <= 1).all():
            raise DelayError(f"rank correlation of {name}: {self.value} is not within -1 and 1")
        object.__setattr__(self, "_scores", 2.0 * np.sin(math.pi / 6.0 * matrix))
        self.roots(np.zeros(size))

    def roots(self, factors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what makes independent normal noise into that of the channels.

        Args:
            factors: (C,) autocorrelation a of each channel's scores.

        Returns:
            (C, C) roots of the correlation of the scores, and of that of the innovations
            r (1 - a b) / sqrt((1 - a^2) (1 - b^2)), which leaves the scores with r.

        Raises:
            DelayError: no joint distribution has these correlations.
        """
        scores: np.ndarray = self._scores  # pyright: ignore[reportAttributeAccessIssue]
        gain = np.sqrt(1.0 - factors**2)
        innovations = scores * (1.0 - np.outer(factors, factors)) / np.outer(gain, gain)
        return self._root(scores), self._root(innovations)

    def to_dict(self) -> dict[str, Any]:
        """Describe the correlation in plain numbers, strings and lists."""
        value = self.value if isinstance(self.value, float) else np.asarray(self.value).tolist()
        return {"channels": list(self.channels), "value": value}

    def _root(self, matrix: np.ndarray) -> np.ndarray:
        values, vectors = np.linalg.eigh(matrix)
        if values[0] < -1e-9:
            raise DelayError(
                f"rank correlation of {' and '.join(self.channels)}: no joint law has the correlations "
                f"{self.value} together with the autocorrelations of the channels"
            )
        # The sign of eigenvectors may differ between machines, that of this symmetric root may not.
        return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def make_correlation(spec: RankCorrelation | Mapping[str, Any]) -> RankCorrelation:
    """Build a rank correlation from its description or return it.

    Raises:
        DelayError: the description does not fit.
    """
    if isinstance(spec, RankCorrelation):
        return spec
    try:
        return RankCorrelation(**spec)
    except TypeError as error:
        raise DelayError(f"rank correlation: {error}") from error

"""Points that maps are drawn at, and how values at them are painted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import Normalize

from deepkoco.koopman.latent_model import Array


@dataclass(frozen=True)
class Points:
    """Observations with two coordinates to draw them at.

    Attributes:
        observations: (n, N).
        x, y: Coordinates (n,).
        labels: Of x and y, with units where they are known.
        shape: (rows, columns) of a grid, row by row; None for scattered points.
        held: Said of entries that the plane does not set; may be empty.
    """

    observations: Array
    x: Array
    y: Array
    labels: tuple[str, str]
    shape: tuple[int, int] | None = None
    held: str = ""

    def described(self) -> str:
        """What the reader looks at, for captions."""
        if self.shape is None:
            return f"the visited observations, drawn over {self.labels[0]} and {self.labels[1]}"
        return f"the plane of {self.labels[0]} and {self.labels[1]}{self.held}"

    def thinned(self, most: int) -> Points:
        """At most so many points, evenly, for tables that stay small."""
        if self.shape is None:
            stride = int(np.ceil(self.x.size / most))
            return self._taken(np.arange(0, self.x.size, stride), None)
        stride = int(np.ceil(np.sqrt(self.x.size / most)))
        index = np.arange(self.x.size).reshape(self.shape)[::stride, ::stride]
        return self._taken(index.ravel(), (index.shape[0], index.shape[1]))

    def _taken(self, index: np.ndarray, shape: tuple[int, int] | None) -> Points:
        return replace(
            self, observations=self.observations[index], x=self.x[index], y=self.y[index], shape=shape
        )


def paint(
    axes: Axes, points: Points, values: Array, colours: str, norm: Normalize | None = None
) -> QuadMesh | PathCollection:
    """Draw one value per point.

    Args:
        axes: Where.
        points: n points.
        values: (n,).
        colours: Name of a colour map.
        norm: From value to colour.

    Returns:
        What a colour bar needs.
    """
    axes.grid(visible=False)
    if points.shape is None:
        return axes.scatter(
            points.x, points.y, c=values, s=4, cmap=colours, norm=norm, linewidths=0, rasterized=True
        )
    x, y, z = (array.reshape(points.shape) for array in (points.x, points.y, values))
    return axes.pcolormesh(x, y, z, cmap=colours, norm=norm, shading="nearest", rasterized=True)

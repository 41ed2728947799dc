"""Where the latent dynamics are not linear: the residual of one step."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from deepkoco.analysis.measures.rollout import Rollout
from deepkoco.koopman.latent_model import Array
from deepkoco.output.colours import COLOURS, MAGNITUDE
from deepkoco.output.picture import Picture


def linearity_residual(rollout: Rollout) -> Array:
    """|phi(o_1, a_1) - Lambda s_0 - B da_0| of every window, in spreads of the latent (W,)."""
    flat = rollout.encoded.reshape(-1, rollout.encoded.shape[-1])
    spread = np.sqrt(np.square(flat - flat.mean(0)).sum(-1).mean())
    residual = np.linalg.norm(rollout.latents[:, 1] - rollout.encoded[:, 1], axis=-1)
    return residual / spread if spread > 0 else np.zeros_like(residual)


def draw_linearity(rollout: Rollout, x: Array, y: Array, labels: tuple[str, str]) -> Picture:
    """Histogram of the residual, and where it is large.

    Args:
        rollout: Predictions over at least one step.
        x, y: Coordinates of the windows' first steps (W,).
        labels: Of the coordinates.

    Returns:
        The picture.
    """
    residual = linearity_residual(rollout)
    top = max(float(residual.max()), 1e-9)
    floor = float(np.clip(np.quantile(residual, 0.005), 1e-4 * top, 0.5 * top))
    shown = np.clip(residual, floor, None)
    figure = Figure(figsize=(9.0, 3.4))
    left, right = figure.subplots(1, 2)
    left.hist(shown, bins=np.geomspace(floor, top * 1.01, 40).tolist(), color=COLOURS["DeepKoCo"])
    left.axvline(float(np.median(shown)), color=COLOURS["measured"], linestyle="--", label="median")
    left.set(xscale="log", xlabel="residual of one step / spread of the latent", ylabel="number of steps")
    left.legend()
    order = np.argsort(shown)  # the largest on top
    norm = LogNorm(floor, top)
    drawn = right.scatter(
        x[order], y[order], c=shown[order], s=6, cmap=MAGNITUDE, norm=norm, linewidths=0, rasterized=True
    )
    right.set(xlabel=labels[0], ylabel=labels[1])
    bar = figure.colorbar(drawn, ax=right, label="residual")
    for scale in (bar.ax.yaxis, left.xaxis):
        scale.set_major_formatter("{x:g}")
        scale.set_minor_formatter("{x:g}")
        scale.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    caption = (
        "How far the latent state really went in one step from where the linear dynamics put it, as a fraction of "
        f"the spread of the latent state: the median is {np.median(residual):.2g}, the worst {residual.max():.2g}. "
        "The right panel shows where the linear picture fails, which is where the learned features have kinks or "
        "where the system was seldom seen."
    )
    table = pd.DataFrame({"x": x, "y": y, "residual": residual})
    return Picture("linearity", "Is the latent state really linear?", caption, figure, table)

"""The eigenvalues on the plane, and how they moved in training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from scipy.optimize import isotonic_regression

from deepkoco.analysis.measures.contribution import Contribution
from deepkoco.analysis.measures.modes import Modes
from deepkoco.koopman.latent_model import Array
from deepkoco.output.colours import SIGNED
from deepkoco.output.picture import Picture

NUMBERED = 12
"""Pairs with a label; more would cover each other."""


def eigenvalue_table(modes: Modes, contribution: Contribution) -> pd.DataFrame:
    """One row per mode: discrete and continuous eigenvalue, time constants and share of the cost."""
    rates = modes.continuous
    with np.errstate(divide="ignore"):
        period = 2.0 * np.pi / np.abs(rates.imag)
        doubling = np.log(2.0) / rates.real
    return pd.DataFrame(
        {
            "pair": np.arange(1, len(rates) + 1),
            "real": modes.eigenvalues.real,
            "imaginary": modes.eigenvalues.imag,
            "modulus": np.abs(modes.eigenvalues),
            "mu_per_s": rates.real,
            "omega_rad_per_s": rates.imag,
            "period_s": period,
            "doubling_time_s": doubling,
            "share_of_cost": contribution.shares,
        }
    )


def draw_eigenvalues(modes: Modes, contribution: Contribution) -> Picture:
    """Unit circle and continuous plane, coloured by the share of the cost."""
    table = eigenvalue_table(modes, contribution)
    figure = Figure(figsize=(9.0, 4.0))
    left, right = figure.subplots(1, 2)
    reach = max(float(np.abs(contribution.shares).max()), 1e-9)
    norm = TwoSlopeNorm(0.0, -reach, reach)
    looks = {"cmap": SIGNED, "norm": norm, "edgecolors": "#222222", "linewidths": 0.7, "s": 60, "zorder": 3}
    both = np.concatenate([modes.eigenvalues, modes.eigenvalues.conj()])
    shares = np.tile(contribution.shares, 2)
    _draw_unit_circle(left)
    left.scatter(both.real, both.imag, c=shares, **looks)
    left.set(xlabel="real part", ylabel="imaginary part", title="per step, with the unit circle")
    rates = np.concatenate([modes.continuous, modes.continuous.conj()])
    right.axvline(0.0, color="#222222", linewidth=0.8)
    right.scatter(rates.real, rates.imag, c=shares, **looks)
    right.set(xlabel="growth rate μ [1/s]", ylabel="frequency ω [rad/s]", title="in continuous time")
    numbered = np.argsort(-np.abs(contribution.shares), kind="stable")[:NUMBERED]
    for place, i in enumerate(np.sort(numbered)):
        rate = modes.continuous[i]
        # Labels alternate sides, else neighbours cover each other.
        side = 7 if place % 2 else -7
        right.annotate(
            str(i + 1),
            (rate.real, rate.imag),
            xytext=(side, 4),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            fontsize=8,
        )
    figure.colorbar(
        ScalarMappable(norm, SIGNED), ax=[left, right], label="share of the predicted cost", pad=0.01
    )
    growing = int((np.abs(modes.eigenvalues) > 1.0).sum())
    fastest = float(modes.continuous.real.max())
    caption = (
        "Every pair of points is one learned oscillation of the latent state: the angle is how far it turns in a "
        "step, the distance from the circle (or from the line) whether it dies out, inside, or grows, outside. "
        f"{growing} of {len(table)} grow here, the fastest by a factor {np.exp(fastest):.3g} per second, which is "
        "harmless only as long as plans are no longer than the windows the model was trained on; colours say how "
        "much of the predicted cost runs through a pair."
        + (f" The {NUMBERED} with the largest shares are numbered." if len(table) > NUMBERED else "")
    )
    return Picture("eigenvalues", "What oscillates in the latent state?", caption, figure, table)


def _draw_unit_circle(axes: Axes) -> None:
    # As an artist it has no say in the limits: slow modes crowd at 1, and the picture shows where they are.
    axes.add_artist(Circle((0.0, 0.0), 1.0, fill=False, color="#222222", linewidth=0.8))
    axes.update_datalim([(1.0, 0.0)])
    axes.margins(0.1)
    axes.set_aspect("equal", adjustable="datalim")  # else neither angles nor distances could be read off


def spread_labels(values: Array, gap: float) -> Array:
    """Heights of labels that do not cover each other, as close to their values as that allows.

    Args:
        values: Where the labels belong (n,).
        gap: Least distance between two labels.

    Returns:
        Heights (n,), in the order of the values.

    Source: isotonic regression of the values less multiples of the gap.
    """
    order = np.argsort(values, kind="stable")
    offsets = gap * np.arange(values.size)
    heights = np.empty_like(values)
    heights[order] = isotonic_regression(values[order] - offsets).x + offsets
    return heights


def draw_history(path: Path) -> Picture | None:
    """Growth rates and frequencies over the training episodes.

    Args:
        path: File eigenvalues.csv of a run.

    Returns:
        The picture; None where there is no such file or it has a single row.
    """
    if not path.is_file():
        return None
    table = pd.read_csv(path)
    if len(table) < 2:
        return None
    figure = Figure(figsize=(9.0, 3.4))
    panels = figure.subplots(1, 2)
    pairs = sum(name.startswith("mu_") for name in table)
    for axes, name, label in zip(
        panels, ("mu", "omega"), ("growth rate μ [1/s]", "frequency ω [rad/s]"), strict=True
    ):
        for pair in range(1, pairs + 1):
            values = table[f"{name}_{pair}"].to_numpy()
            axes.plot(table["episodes"], values, marker=".", markersize=3)
        axes.set(xlabel="training episodes", ylabel=label)
        last = table[[f"{name}_{pair}" for pair in range(1, pairs + 1)]].iloc[-1].to_numpy(np.float64)
        low, high = axes.get_ylim()
        size = min(7.0, 210.0 / pairs)  # [points]; about 210 of them make the height of the axes
        heights = spread_labels(last, (high - low) * size / 210.0)
        for pair, (line, height) in enumerate(zip(axes.lines, heights, strict=True), start=1):
            axes.annotate(
                str(pair), (1.01, height), xycoords=("axes fraction", "data"), va="center",
                fontsize=size, color=line.get_color(), annotation_clip=False,
            )  # fmt: skip
    first = table["episodes"].iloc[1]
    caption = (
        "How the eigenvalues moved while the model was trained; the first point is where they started, before any "
        f"training, the next is after the {first:.0f} episodes of the first phase. Lines that are still sloping at "
        "the end belong to pairs that had not settled."
    )
    return Picture("eigenvalue_history", "Have the eigenvalues settled?", caption, figure, table)

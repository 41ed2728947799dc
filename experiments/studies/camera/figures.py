"""Figures of the study of the camera chain: open-loop errors, angles, estimates."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.graph.drawing.style import INK, PALETTE, QUIET, figure_style

FITS = ("true values", "all", "no camera delay", "camera alone", "nominal camera")
GOAL = 5.0  # open-loop error [deg]
SHOWN = {
    "actuation_delay.delay": ("delay of commands [ms]", 1e3),
    "camera_delay": ("delay of the camera [ms]", 1e3),
    "sum of both delays": ("sum of both delays [ms]", 1e3),
    "roll": ("roll [deg]", 180.0 / np.pi),
    "tilt_u": ("tilt_u [deg]", 180.0 / np.pi),
    "tilt_v": ("tilt_v [deg]", 180.0 / np.pi),
    "pivot_u": ("pivot_u [px]", 1.0),
    "pivot_v": ("pivot_v [px]", 1.0),
    "scale": ("scale [px]", 1.0),
}


def geometric_mean(values: np.ndarray) -> tuple[float, float, float]:
    """Geometric mean and its 95 % interval, by Student's t on logarithms; errors of units differ by factors."""
    mean, low, high = (float(np.exp(x)) for x in mean_with_band(np.log(values)))
    return mean, low, high


def draw_errors(units: pd.DataFrame) -> Figure:
    """Open-loop error and error of the reading: each unit as a dot, geometric mean with its interval."""
    with figure_style():
        figure = Figure(figsize=(9.0, 3.0), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        columns = (
            ("open_loop_rms_deg", "open-loop error over 21 s, rms [deg]"),
            ("reading_rms_deg", "error of the angle that is read, rms [deg]"),
        )
        for axis, (column, label) in zip(axes, columns, strict=True):
            for place, kind in enumerate(FITS):
                own = units.loc[units.fit == kind, column].to_numpy()
                axis.plot(own, np.full(len(own), place + 0.2), ".", color=PALETTE[place], alpha=0.7)
                mean, low, high = geometric_mean(own)
                if np.isfinite([low, high]).all():
                    axis.plot([low, high], [place, place], color=PALETTE[place])
                axis.plot(mean, place, "o", color=PALETTE[place])
            axis.set(xscale="log", xlabel=label)
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axes[0].axvline(GOAL, color=QUIET, ls=":")
        axes[0].set(yticks=range(len(FITS)), yticklabels=FITS)
        axes[0].invert_yaxis()
    return figure


def draw_open_loop(curves: pd.DataFrame) -> Figure:
    """True and simulated angles of every unit, and their difference."""
    seeds = sorted(curves.seed.unique())
    with figure_style():
        figure = Figure(figsize=(9.0, 1.7 * len(seeds)), layout="constrained")
        grid = figure.subplots(len(seeds), 2, sharex=True, squeeze=False)
        for (left, right), seed in zip(grid, seeds, strict=True):
            for place, kind in enumerate(FITS[1:], start=1):
                own = curves[(curves.seed == seed) & (curves.fit == kind)]
                if kind == "all":
                    left.plot(own.time_s, own.true_deg, color=INK, lw=2.2, alpha=0.35, label="true")
                    left.plot(own.time_s, own.angle_deg, color=PALETTE[place], lw=0.9, label="all, open loop")
                right.plot(own.time_s, own.angle_deg - own.true_deg, color=PALETTE[place], lw=0.9, label=kind)
            right.set_ylim(-20.0, 20.0)
            left.set_ylabel(f"unit {seed}\nangle [deg]")
            right.set_ylabel("error [deg]")
        grid[-1, 0].set_xlabel("time [s]")
        grid[-1, 1].set_xlabel("time [s]")
        grid[0, 0].legend(fontsize=7, loc="upper right")
        grid[0, 1].legend(fontsize=7, ncols=2, loc="upper right")
    return figure


def draw_estimates(estimates: pd.DataFrame) -> Figure:
    """Error of delays and camera parameters of each unit with 95 % intervals: the fit of all, and the camera alone."""
    with figure_style():
        figure = Figure(figsize=(9.0, 5.4), layout="constrained")
        for axis, (name, (label, factor)) in zip(np.ravel(figure.subplots(3, 3)), SHOWN.items(), strict=True):
            # Delays of a camera alone are open, with intervals as wide as their bounds: they would hide the others.
            kinds = ("all",) if name in ("actuation_delay.delay", "camera_delay") else ("all", "camera alone")
            for kind, shift in zip(kinds, (-0.12, 0.12), strict=False):
                own = estimates[(estimates.parameter == name) & (estimates.fit == kind)]
                error, below, above = (
                    factor * x.to_numpy()
                    for x in (own.found - own.true, own.found - own.low, own.high - own.found)
                )
                axis.errorbar(
                    own.seed + shift,
                    error,
                    [below, above],
                    fmt="o",
                    ms=3,
                    color=PALETTE[FITS.index(kind)],
                    label=kind,
                )
            axis.axhline(0.0, color=QUIET, lw=0.7)
            axis.set_title(f"error of {label}", fontsize=8)
            axis.set_xticks(sorted(estimates.seed.unique()))
        figure.axes[2].legend(fontsize=7)
        figure.supxlabel("unit", fontsize=9)
    return figure

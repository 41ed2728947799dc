"""First picture of a robot with several joints: where its simulation is wrong."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import COLOURS, Layout, held_out_models
from deepkoco.diagnose.report.joint_rows import LEVELS, JointError, joint_errors, level
from deepkoco.output.picture import Picture
from deepkoco.systems import ExtendedSystem, System

COLOUR_OF = {"good": "#2f9e6e", "fair": "#e69f00", "poor": "#d62828"}
LINK, UNKNOWN = "#9a9a9a", "#b9b9b9"
CLOSEST = 0.16  # of labels, as a share of the picture's height


def joints_picture(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Draw the robot with its joints coloured by their error, and the errors as bars; None for one joint."""
    system = details.system
    errors = joint_errors(diagnosis, details) if system.own_joints > 1 else []
    if not errors:
        return None
    base = system.base if isinstance(system, ExtendedSystem) else system
    outline = base.outline(_pose(diagnosis, system))
    beside = layout.columns > 1
    rows = 0.42 * len(errors) + 1.4
    if outline is None:
        figure = Figure(figsize=(layout.width, rows))
        bars = figure.subplots()
    elif beside:
        figure = Figure(figsize=(layout.width, max(rows, 3.6)))
        drawing, bars = figure.subplots(1, 2, width_ratios=[1.0, 1.2])
        _draw_robot(drawing, system, errors, outline)
    else:
        figure = Figure(figsize=(layout.width, rows + 3.6))
        drawing, bars = figure.subplots(2, 1, height_ratios=[3.6, rows])
        _draw_robot(drawing, system, errors, outline)
    last = list(held_out_models(diagnosis).values())[-1]
    _draw_bars(bars, errors, last, None if beside and outline is not None else figure)
    if beside and outline is not None:
        figure.legend(handles=_legend(last), loc="outside upper right", ncols=2)
    worst = max(errors, key=lambda e: e.given / e.noise)
    caption = (
        "Error of each joint on held-out windows, in standard deviations of its sensor's noise: grey as given, in "
        f"colour with the {last}. A simulation at 1 cannot be distinguished from the real machine. "
        f"As given, the simulation is worst at {worst.joint}."
    )
    if outline is not None:
        caption += f" The colours: green is {LEVELS['good']}, amber {LEVELS['fair']}, red {LEVELS['poor']}."
    table = pd.DataFrame(
        [(e.joint, e.channel, e.unit, e.given, e.final, e.noise) for e in errors],
        columns=["joint", "channel", "unit", "error_as_given", "error_final", "noise_sd"],
    )
    return Picture("joints", "Which joint is wrong", caption, figure, table)


def _pose(diagnosis: Diagnosis, system: System) -> np.ndarray:
    """(J,) coordinates in the middle of the measured motion; 0 where a joint is not measured."""
    windows = diagnosis.gain.replayed if diagnosis.gain is not None else None
    pose = np.zeros(system.joints)
    if windows is not None:
        for c, state in enumerate(windows.shows):
            valid = windows.valid[:, c].numpy()
            if state < system.joints and valid.any():
                pose[state] = float(np.median(windows.value[:, c].numpy()[valid]))
    return pose


def _draw_robot(axis: Axes, system: System, errors: list[JointError], outline: tuple) -> None:
    lines, points = outline
    for start, end in lines:
        axis.plot(*zip(start, end, strict=True), color=LINK, lw=5, solid_capstyle="round", zorder=1)
    colours = {e.joint: COLOUR_OF[level(e.final, e.noise)] for e in errors}
    place = np.array(points)
    for point, name in zip(place, system.joint_names, strict=True):
        axis.plot(
            *point, "o", color=colours.get(name, UNKNOWN), markersize=13, markeredgecolor="#ffffff", zorder=3
        )
    every = np.array([*place, *(p for line in lines for p in line)])
    low, high = every.min(0), every.max(0)
    size = float(max(high - low)) or 1.0
    order = np.argsort(place[:, 1], kind="stable")
    heights = _apart(place[order, 1], CLOSEST * size)
    for k, height in zip(order, heights, strict=True):
        axis.annotate(
            system.joint_names[k],
            (float(place[k, 0]), float(place[k, 1])),
            (high[0] + 0.22 * size, height),
            va="center",
            fontsize=9,
            arrowprops={"arrowstyle": "-", "color": LINK, "lw": 0.8},
        )
    axis.set_xlim(low[0] - 0.15 * size, high[0] + 0.95 * size)
    axis.set_ylim(min(low[1], heights.min()) - 0.12 * size, max(high[1], heights.max()) + 0.12 * size)
    axis.set_aspect("equal")
    axis.set_axis_off()


def _apart(values: np.ndarray, least: float) -> np.ndarray:
    """Rising values moved as little as needed to be at least ``least`` apart, about their own middle."""
    result = values.astype(float).copy()
    for k in range(1, len(result)):
        result[k] = max(result[k], result[k - 1] + least)
    return result - 0.5 * ((result - values).min() + (result - values).max())


def _draw_bars(axis: Axes, errors: list[JointError], last: str, figure: Figure | None) -> None:
    at = np.arange(len(errors))
    given = np.array([e.given / e.noise for e in errors])
    final = np.array([e.final / e.noise for e in errors])
    levels = [level(e.final, e.noise) for e in errors]
    axis.barh(at - 0.2, given, 0.36, color=COLOURS["baseline"])
    axis.barh(at + 0.2, final, 0.36, color=[COLOUR_OF[k] for k in levels])
    axis.axvline(1.0, color="#222222", lw=1, ls=":")
    axis.set_xscale("log")
    top = max(float(given.max()), float(final.max()), FAR_RIGHT)
    axis.set_xlim(0.5, 2.5 * top)
    for y, value in (*zip(at - 0.2, given, strict=True), *zip(at + 0.2, final, strict=True)):
        axis.text(max(value, 0.5), y, f" {value:.3g}", va="center", fontsize=8)
    axis.set_yticks(at, [e.joint for e in errors])
    axis.invert_yaxis()
    axis.grid(axis="y", visible=False)
    axis.set_xlabel("error [standard deviations of the sensor's noise]")
    if figure is not None:
        figure.legend(handles=_legend(last), loc="outside upper center", ncols=1)


def _legend(last: str) -> list[Patch | Line2D]:
    """Entries without the colour of one level."""
    return [
        Patch(facecolor=COLOURS["baseline"], label="simulation as given"),
        Patch(facecolor="#ffffff", edgecolor="#222222", label=f"{last} (colour: see below)"),
        Line2D([], [], color="#222222", lw=1, ls=":", label="sensor noise"),
    ]


FAR_RIGHT = 3.0  # least end of the axis, so that errors at the noise have room

"""Draw the pictures of a fit, each with a table of its data."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.fit.delays.hidden_delay import HiddenDelays
from deepkoco.fit.identification import Identification
from deepkoco.output.picture import Picture, house_style

COLOURS = {"measured": "#222222", "before": "#9a9a9a", "fitted": "#3b7dd8"}
SHOWN_WINDOWS = 4


def draw_all(found: Identification, hidden: HiddenDelays | None = None) -> list[Picture]:
    """Draw replay, intervals, correlation (from two parameters on), convergence and the law of the hidden delays."""
    drawings = (replay, intervals, correlation, convergence)
    with house_style():
        pictures = [draw(found) for draw in drawings]
        if hidden is not None:
            pictures.append(delays(hidden))
    return [picture for picture in pictures if picture is not None]


def replay(found: Identification) -> Picture:
    """Draw the measurements of a few windows, and their simulation before and after the fit."""
    windows, channels = found.request.windows, found.system.measurements
    count = min(SHOWN_WINDOWS, len(windows))
    chosen = np.unique(np.linspace(0, len(windows) - 1, count).round().astype(int))
    figure = Figure(figsize=(9.0, 2.0 * len(channels) + 0.8))
    grid = figure.subplots(len(channels), len(chosen), sharex="col", squeeze=False)
    rows = []
    for c, channel in enumerate(channels):
        for axis, w in zip(grid[c], chosen, strict=True):
            valid = windows.valid[w, c].numpy()
            t = windows.t[w, c].numpy()[valid] + windows.t0[w]
            value = windows.value[w, c].numpy()[valid]
            before, after = (
                value - windows.errors(f.residual)[w, c].numpy()[valid] for f in (found.before, found.fit)
            )
            axis.plot(t, value, ".", color=COLOURS["measured"], markersize=3, label="measured")
            axis.plot(t, before, color=COLOURS["before"], label="simulation before the fit")
            axis.plot(t, after, color=COLOURS["fitted"], label="simulation after the fit")
            frame = {"channel": channel.name, "unit": channel.unit, "window": w, "time_s": t}
            rows.append(pd.DataFrame({**frame, "measured": value, "before": before, "fitted": after}))
        grid[c][0].set_ylabel(f"{channel.name} [{channel.unit}]")
    for axis in grid[-1]:
        axis.set_xlabel("time [s]")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    caption = (
        "Measurements, and simulations under the same commands. The initial state of each window is fitted."
    )
    return Picture("replay", "Replay of the log", caption, figure, pd.concat(rows))


def intervals(found: Identification) -> Picture:
    """Draw each parameter with its 95 % interval and its start value."""
    estimates = list(found.estimates.values())
    figure = Figure(figsize=(9.0, 0.9 * len(estimates) + 0.6))
    axes = figure.subplots(len(estimates), 1, squeeze=False)[:, 0]
    for axis, e in zip(axes, estimates, strict=True):
        axis.plot([e.low, e.high], [0, 0], color=COLOURS["fitted"], lw=4, solid_capstyle="butt", alpha=0.5)
        axis.plot(e.value, 0, "o", color=COLOURS["fitted"], label="fitted, 95 % interval")
        axis.plot(e.start, 0, "d", color=COLOURS["before"], label="before the fit")
        axis.set_yticks([0], [e.name])
        axis.set_ylim(-1, 1)
        axis.margins(x=0.15)
        axis.grid(axis="y", visible=False)
        axis.annotate(
            f"[{e.unit}]", (1.0, 0.0), (4, 0), "axes fraction", textcoords="offset points", fontsize=8
        )
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    table = pd.DataFrame(
        [
            {
                "parameter": e.name,
                "value": e.value,
                "low": e.low,
                "high": e.high,
                "sd": e.sd,
                "start": e.start,
                "unit": e.unit,
            }
            for e in estimates
        ]
    )
    caption = (
        "Each parameter has its own scale. A bar across the whole axis: the log hardly limits the parameter."
    )
    return Picture("intervals", "Parameters", caption, figure, table)


def correlation(found: Identification) -> Picture | None:
    """Draw the correlation matrix of the estimates; None for a single parameter."""
    names = list(found.estimates)
    if len(names) < 2:
        return None
    matrix = found.correlation
    size = 0.7 * len(names) + 2.4
    figure = Figure(figsize=(size + 1.0, size))
    axis = figure.subplots()
    image = axis.imshow(matrix, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    axis.set_xticks(range(len(names)), names, rotation=35, ha="right")
    axis.set_yticks(range(len(names)), names)
    axis.grid(visible=False)
    for i in range(len(names)):
        for j in range(len(names)):
            colour = "white" if abs(matrix[i, j]) > 0.6 else "black"
            axis.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=8, color=colour)
    figure.colorbar(image, ax=axis, label="correlation", shrink=0.8)
    table = pd.DataFrame(matrix, columns=names)
    table.insert(0, "parameter", names)
    caption = "Near 1 or -1, the log identifies a combination of the two parameters, not each of them."
    return Picture("correlation", "Correlation of the estimates", caption, figure, table)


def convergence(found: Identification) -> Picture:
    """Draw the cost of every iteration of every stage."""
    figure = Figure(figsize=(9.0, 3.0))
    axis = figure.subplots()
    rows, begin = [], 1
    for name, costs in found.convergence.stages:
        at = begin + np.arange(len(costs))
        axis.plot(at, costs, "o-", markersize=3, label=name)
        rows.append(pd.DataFrame({"stage": name, "iteration": at, "cost": costs}))
        begin += len(costs)
    axis.set_yscale("log")
    axis.set_xlabel("generation" if found.convergence.method == "cma" else "iteration")
    axis.set_ylabel("squared error / noise variance")
    axis.legend()
    caption = "Costs of different stages cannot be compared: the windows or the assumed noise differ."
    return Picture("convergence", "Convergence", caption, figure, pd.concat(rows))


def delays(hidden: HiddenDelays) -> Picture:
    """Draw the delay of each command message, and the density of the fitted law."""
    figure = Figure(figsize=(9.0, 3.0))
    left, right = figure.subplots(1, 2, width_ratios=[3, 1], sharey=True)
    late, sd = 1e3 * hidden.delay, 1e3 * hidden.delay_sd
    left.errorbar(
        hidden.sent, late, yerr=sd, fmt=".", color=COLOURS["measured"], elinewidth=0.7, markersize=4
    )
    left.set_xlabel("sent [s]")
    left.set_ylabel("delay [ms]")
    reach = 4.0 * 1e3 * float(hidden.spreads.max())
    at = np.linspace(max(min(1e3 * hidden.means) - reach, 0.0), max(1e3 * hidden.means) + reach, 400)
    score = (at[:, None] - 1e3 * hidden.means) / (1e3 * hidden.spreads)
    part = hidden.weights / (1e3 * hidden.spreads) * np.exp(-0.5 * score**2) / np.sqrt(2.0 * np.pi)
    right.plot(part.sum(1), at, color=COLOURS["fitted"])
    right.set_xlabel("density [1/ms]")
    table = pd.DataFrame(
        {"log": hidden.log + 1, "sent_s": hidden.sent, "delay_s": hidden.delay, "delay_sd_s": hidden.delay_sd}
    )
    caption = "Left: estimated delay of each message and its standard deviation. Right: fitted density of the delays."
    return Picture("delays", "Hidden delays of the commands", caption, figure, table)

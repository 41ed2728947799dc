"""All pictures of a report with their tables; this file draws those that compare the simulations on the log."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.chances_figure import probabilities
from deepkoco.diagnose.report.figures.error_map import error_map
from deepkoco.diagnose.report.figures.friction_figure import friction_picture
from deepkoco.diagnose.report.figures.joints_figure import joints_picture
from deepkoco.diagnose.report.figures.layout import COLOURS, DESKTOP, Layout, held_out_models, shown_models
from deepkoco.diagnose.report.figures.missing_figure import missing_picture
from deepkoco.diagnose.report.figures.parameter_figures import found_parameters, own_parameters
from deepkoco.diagnose.report.figures.ranking_figure import candidates
from deepkoco.diagnose.report.figures.timing_figure import timing
from deepkoco.output.picture import Picture, house_style

MOST_BARS = 24  # windows up to which each one gets its own bars
REFIT_WORSE = (
    "The refit without the cause is worse here than the simulation as given. It moves the simulation's own parameters "
    "to imitate the cause on the fitted windows, and these parameters are wrong on other windows."
)


def draw_all(diagnosis: Diagnosis, layout: Layout = DESKTOP) -> list[Picture]:
    """Return every picture for which the diagnosis has data, most informative first."""
    if diagnosis.details is None:
        return []
    drawings: tuple[Callable[[Diagnosis, Details, Layout], Picture | None], ...] = (
        joints_picture,
        replay,
        missing_picture,
        friction_picture,
        probabilities,
        candidates,
        found_parameters,
        error_by_horizon,
        error_map,
        before_after,
        own_parameters,
        timing,
    )
    with house_style():
        pictures = [draw(diagnosis, diagnosis.details, layout) for draw in drawings]
    return [picture for picture in pictures if picture is not None]


def replay(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture:
    """Measured and simulated first channel over a few windows."""
    gain = diagnosis.gain
    if gain is not None:
        windows, fits, where = gain.replayed, gain.fits, "held-out windows"
    else:
        windows, where = details.windows, "fitted windows"
        fits = {
            "baseline": details.nominal or details.refit,
            "refit": details.refit,
            "extended": details.final,
        }
    count = min(max(layout.columns, 2), len(windows))
    chosen = np.unique(np.linspace(0, len(windows) - 1, count).round().astype(int))
    figure = Figure(figsize=(layout.width, 4.2 if layout.columns > 1 else 4.8))
    upper, lower = figure.subplots(2, len(chosen), sharex="col", squeeze=False, height_ratios=[2.0, 1.0])
    channel = details.channels[0]
    sd, errors = windows.noise[0].sd, {name: windows.errors(fit.residual) for name, fit in fits.items()}
    rows = []
    models = shown_models(diagnosis) if gain is None else held_out_models(diagnosis)
    for column, w in enumerate(chosen):
        valid = windows.valid[w, 0].numpy()
        t = windows.t[w, 0].numpy()[valid] + windows.t0[w]
        value = windows.value[w, 0].numpy()[valid]
        upper[column].plot(t, value, ".", color=COLOURS["measured"], markersize=3, label="measured")
        frame = {"window": w, "time_s": t, "measured": value}
        for model in models:
            error = errors[model][w, 0].numpy()[valid]
            upper[column].plot(t, value - error, color=COLOURS[model], label=models[model])
            lower[column].plot(t, -error, color=COLOURS[model])
            frame[model] = value - error
        lower[column].axhspan(-2 * sd, 2 * sd, color="#000000", alpha=0.12, lw=0, label="sensor noise, 2 sd")
        lower[column].set_xlabel("time [s]")
        rows.append(pd.DataFrame(frame))
    upper[0].set_ylabel(f"{channel[0]} [{channel[1]}]")
    lower[0].set_ylabel(f"error [{channel[1]}]")
    handles, labels = upper[0].get_legend_handles_labels()
    band = lower[0].get_legend_handles_labels()
    figure.legend(
        handles + band[0],
        labels + band[1],
        loc="outside upper center",
        ncols=layout.entries,
        columnspacing=1.2,
        handlelength=1.4,
        markerscale=2,
    )
    caption = (
        f"Above: measured and simulated values under the same commands, on {where} of the log. Below: simulated minus "
        "measured. The grey band is the sensor noise. A simulation inside the band cannot be distinguished from the "
        "real machine here."
    )
    return Picture("replay", "The log, replayed in simulation", caption, figure, pd.concat(rows))


def error_by_horizon(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Held-out error over the time since the start of the simulation."""
    gain = diagnosis.gain
    if gain is None:
        return None
    rows, columns = layout.grid(len(gain.channels))
    figure = Figure(figsize=(layout.width, 0.8 + 2.6 * rows))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    frame: dict[str, np.ndarray] = {"horizon_s": gain.curve_time}
    for axis, channel in zip(axes, gain.channels, strict=False):
        for model, label in held_out_models(diagnosis).items():
            curve = gain.curves[model][channel.name]
            axis.plot(gain.curve_time, curve, color=COLOURS[model], label=label)
            frame[f"{model}_{channel.name}"] = curve
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel("time simulated so far [s]")
        axis.set_ylabel(f"error of {channel.name} [{channel.unit}]")
    for axis in axes[len(gain.channels) :]:
        axis.set_visible(False)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=min(3, layout.entries)
    )
    caption = (
        f"Root mean square error of each simulation over the time since its start, "
        f"on {gain.windows} held-out windows of {gain.horizon:.2g} s. The initial state is "
        f"fitted on each window. {diagnosis.gain_note}"
    )
    if gain.channels[0].refit > gain.channels[0].baseline and "extended" in shown_models(diagnosis):
        caption += f" {REFIT_WORSE}"
    title = "How the error grows with time"
    return Picture("error_by_horizon", title, caption, figure, pd.DataFrame(frame))


def before_after(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Error of each held-out window under each model."""
    gain = diagnosis.gain
    if gain is None:
        return None
    figure = Figure(figsize=(layout.width, 3.0 + 0.2 * (5 - layout.entries)))
    axis = figure.subplots()
    models = held_out_models(diagnosis)
    valid = gain.replayed.valid[:, 0].numpy()
    sd = gain.replayed.noise[0].sd
    frame: dict[str, np.ndarray] = {
        "window": np.arange(gain.windows),
        "log": gain.replayed.log,
        "start_s": gain.replayed.t0,
    }
    for model in models:
        square = gain.replayed.errors(gain.fits[model].residual)[:, 0].numpy() ** 2
        frame[model] = np.sqrt(square.sum(1) / valid.sum(1).clip(1))
    if gain.windows > MOST_BARS:
        for model in models:
            axis.plot(frame["window"], frame[model], ".", color=COLOURS[model], label=models[model])
        shown = "Each dot is one held-out window"
    else:
        width = 0.8 / len(models)
        for i, model in enumerate(models):
            place = np.arange(gain.windows) + (i - 0.5 * (len(models) - 1)) * width
            axis.bar(place, frame[model], width, color=COLOURS[model], label=models[model])
        axis.set_xticks(range(gain.windows))
        shown = "Each group of bars is one held-out window"
    axis.axhline(sd, color="#222222", lw=1, ls=":", label="sensor noise")
    axis.set_yscale("log")
    axis.set_xlabel("held-out window")
    axis.set_ylabel(f"error of {gain.channels[0].name} [{gain.channels[0].unit}]")
    figure.legend(loc="outside upper center", ncols=layout.entries)
    caption = (
        f"{shown}, in the order of the log. The scale is logarithmic. The dotted line is the sensor noise, the "
        "smallest error that a simulation can have."
    )
    return Picture("before_after", "Before and after, window by window", caption, figure, pd.DataFrame(frame))

"""The pictures of a report, each with the table behind it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.findings import motion_of
from deepkoco.diagnose.friction_figure import friction_picture
from deepkoco.diagnose.missing_curve import expected_missing_torque
from deepkoco.picture import Picture, house_style

# One colour per model in every figure.
COLOURS = {"measured": "#222222", "baseline": "#9a9a9a", "refit": "#3b7dd8", "extended": "#e4572e"}
LABELS = {
    "baseline": "simulation as given",
    "refit": "simulation, parameters refitted",
    "extended": "simulation with the named cause",
}
SHOWN_WINDOWS = 4


def draw_all(diagnosis: Diagnosis) -> list[Picture]:
    """Every picture that the diagnosis has data for, most telling first."""
    if diagnosis.details is None:
        return []
    drawings: tuple[Callable[[Diagnosis, Details], Picture | None], ...] = (
        replay,
        missing_torque,
        friction_picture,
        candidates,
        error_by_horizon,
        before_after,
        parameters,
    )
    with house_style():
        pictures = [draw(diagnosis, diagnosis.details) for draw in drawings]
    return [picture for picture in pictures if picture is not None]


def _shown_models(diagnosis: Diagnosis) -> tuple[str, ...]:
    return (
        ("baseline", "refit", "extended")
        if diagnosis.names and diagnosis.verdict != "unknown"
        else ("baseline", "refit")
    )


def replay(diagnosis: Diagnosis, details: Details) -> Picture:
    """Measured and simulated first channel over a few windows."""
    gain = diagnosis.gain
    if gain is not None:
        windows, fits, where = gain.replayed, gain.fits, "held-out"
    else:
        windows, where = details.windows, "training"
        fits = {
            "baseline": details.nominal or details.refit,
            "refit": details.refit,
            "extended": details.final,
        }
    count = min(SHOWN_WINDOWS, len(windows))
    chosen = np.unique(np.linspace(0, len(windows) - 1, count).round().astype(int))
    figure = Figure(figsize=(9.0, 4.2))
    upper, lower = figure.subplots(2, len(chosen), sharex="col", squeeze=False, height_ratios=[2.0, 1.0])
    channel = details.channels[0]
    sd = windows.noise[0].sd
    rows = []
    models = _shown_models(diagnosis)
    for column, w in enumerate(chosen):
        valid = windows.valid[w, 0].numpy()
        t = windows.t[w, 0].numpy()[valid] + windows.t0[w]
        value = windows.value[w, 0].numpy()[valid]
        upper[column].plot(t, value, ".", color=COLOURS["measured"], markersize=3, label="measured")
        frame = {"window": w, "time_s": t, "measured": value}
        for model in models:
            error = fits[model].residual[w, 0].numpy()[valid] * sd
            upper[column].plot(t, value - error, color=COLOURS[model], label=LABELS[model])
            lower[column].plot(t, -error, color=COLOURS[model])
            frame[model] = value - error
        lower[column].axhspan(-2 * sd, 2 * sd, color="#000000", alpha=0.08, lw=0)
        lower[column].set_xlabel("time [s]")
        rows.append(pd.DataFrame(frame))
    upper[0].set_ylabel(f"{channel[0]} [{channel[1]}]")
    lower[0].set_ylabel(f"error [{channel[1]}]")
    handles, labels = upper[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    caption = (
        f"Above: what the sensor measured and what each simulation says under the same commands, on {where} "
        "windows. Below: simulated minus measured; the grey band is two standard deviations of sensor noise."
    )
    return Picture("replay", "Replay of the log", caption, figure, pd.concat(rows))


def missing_torque(diagnosis: Diagnosis, details: Details) -> Picture:
    """Torque that the refitted baseline misses, against speed, angle, command and time."""
    missing = details.missing[_joint_shown(details)]
    system = details.system
    motion = motion_of(details.windows, missing, system)
    of_joint = f", joint {missing.joint + 1}" if system.joints > 1 else ""
    position, speed = system.state_units[missing.joint], system.state_units[system.joints + missing.joint]
    turning = position == "rad"
    command_unit = details.command_units[min(missing.joint, len(details.command_units) - 1)]
    torque = missing.torque.ravel()
    named = diagnosis.verdict in ("cause", "ambiguous") and details.final is not details.refit
    curve = expected_missing_torque(details, missing.joint).ravel() if named else None
    axes_of = {
        f"speed{of_joint} [{speed}]": motion.omega,
        f"angle{of_joint}, one turn [rad]" if turning else f"position [{position}]": (
            (motion.theta + np.pi) % (2 * np.pi) - np.pi if turning else motion.theta
        ),
        f"command{of_joint} [{command_unit}]": motion.command,
        "time [s]": motion.time,
    }
    figure = Figure(figsize=(9.0, 5.6))
    grid = figure.subplots(2, 2, sharey=True).ravel()
    reach = float(np.quantile(np.abs(torque), 0.99)) * 1.3 + 1e-12
    for axis, (label, x) in zip(grid, axes_of.items(), strict=True):
        axis.plot(x, torque, ".", color=COLOURS["refit"], markersize=3, alpha=0.3, label="missing load")
        if curve is not None:
            _binned(axis, x, curve, COLOURS["extended"], "what the named cause would leave")
        _binned(axis, x, torque, COLOURS["refit"], "mean of the dots")
        axis.set_xlabel(label)
        axis.set_ylim(-reach, reach)
    for axis in (grid[0], grid[2]):
        axis.set_ylabel(f"missing load [{missing.unit}]")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    table = pd.DataFrame(
        {
            "time_s": motion.time,
            "angle_rad": motion.theta,
            "speed_rad_s": motion.omega,
            "command": motion.command,
            "missing_torque_nm": torque,
            "sd_nm": missing.sd.ravel(),
            "named_cause_nm": curve if curve is not None else np.nan,
        }
    )
    caption = (
        "Each dot is the extra torque, averaged over a short piece of time, that would make the refitted simulation "
        "follow the measurement. Shapeless dots around zero mean that nothing is missing."
    )
    if curve is not None:
        caption += f" The line is what {_title(diagnosis)} alone would leave behind."
    return Picture("missing_torque", "What the refitted simulation misses", caption, figure, table)


def _joint_shown(details: Details) -> int:
    """Joint at which the named cause, or else the most of what is missing, shows."""
    changed = [float(((m.torque / m.sd) ** 2).mean()) for m in details.missing]
    return int(np.argmax(changed))


def _binned(axis: Axes, x: np.ndarray, y: np.ndarray, colour: str, label: str, bins: int = 20) -> None:
    """Mean of y over bins of x that hold equally many points."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, bins + 1)))
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    parts = [y[which == i] for i in range(len(edges) - 1)]
    kept = [i for i, part in enumerate(parts) if len(part)]
    centre = np.array([x[which == i].mean() for i in kept])
    mean = np.array([parts[i].mean() for i in kept])
    axis.plot(centre, mean, color=colour, lw=2.2, label=label)


def candidates(diagnosis: Diagnosis, details: Details) -> Picture:
    """Ranked candidates as bars of delta BIC."""
    names = [c.name for c in diagnosis.candidates]
    score = np.array([c.delta_bic for c in diagnosis.candidates])
    named = set(diagnosis.causes[0].members) if diagnosis.causes else set()
    figure = Figure(figsize=(9.0, 0.28 * len(names) + 1.2))
    axis = figure.subplots()
    colours = [COLOURS["extended"] if n in named else "#c9c9c9" for n in names]
    axis.barh(range(len(names)), score, color=colours)
    axis.set_yticks(range(len(names)), [n.replace("_", " ") for n in names])
    axis.invert_yaxis()
    axis.set_xscale("symlog", linthresh=10.0)
    axis.axvline(diagnosis.detection, color="#222222", lw=1, ls="--")
    axis.text(diagnosis.detection, len(names) - 0.4, " named beyond this line", fontsize=8, va="bottom")
    axis.set_xlabel("evidence: fall of the BIC against the refitted simulation")
    axis.grid(axis="y", visible=False)
    table = pd.DataFrame(
        {"cause": names, "family": [c.family for c in diagnosis.candidates], "delta_bic": score}
    )
    caption = (
        "Every cause of the catalogue was fitted to the same windows. Bars to the right explain the data better "
        "than they cost in extra parameters; coloured bars are the causes that these data do not tell apart."
    )
    return Picture("candidates", "Which cause explains it", caption, figure, table)


def error_by_horizon(diagnosis: Diagnosis, details: Details) -> Picture | None:
    """Held-out error against the time since the simulation started."""
    gain = diagnosis.gain
    if gain is None:
        return None
    figure = Figure(figsize=(9.0, 3.2))
    axes = figure.subplots(1, len(gain.channels), squeeze=False)[0]
    frame: dict[str, np.ndarray] = {"horizon_s": gain.curve_time}
    for axis, channel in zip(axes, gain.channels, strict=True):
        for model in _shown_models(diagnosis):
            curve = gain.curves[model][channel.name]
            axis.plot(gain.curve_time, curve, color=COLOURS[model], label=LABELS[model])
            frame[f"{model}_{channel.name}"] = curve
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel("time since the start of the simulation [s]")
        axis.set_ylabel(f"error of {channel.name} [{channel.unit}]")
    axes[0].legend()
    caption = (
        f"Root mean square error over {gain.windows} held-out windows that no fit has seen. "
        "The start state is fitted on "
        "each window."
    )
    return Picture("error_by_horizon", "Error by horizon", caption, figure, pd.DataFrame(frame))


def before_after(diagnosis: Diagnosis, details: Details) -> Picture | None:
    """Error of each held-out window under each model."""
    gain = diagnosis.gain
    if gain is None:
        return None
    figure = Figure(figsize=(9.0, 2.8))
    axis = figure.subplots()
    models = _shown_models(diagnosis)
    valid = gain.replayed.valid[:, 0].numpy()
    sd = gain.replayed.noise[0].sd
    frame: dict[str, np.ndarray] = {"window": np.arange(gain.windows), "start_s": gain.replayed.t0}
    width = 0.8 / len(models)
    for i, model in enumerate(models):
        square = (gain.fits[model].residual[:, 0].numpy() * sd) ** 2
        error = np.sqrt(square.sum(1) / valid.sum(1).clip(1))
        axis.bar(
            np.arange(gain.windows) + (i - 0.5 * (len(models) - 1)) * width,
            error,
            width,
            color=COLOURS[model],
            label=LABELS[model],
        )
        frame[model] = error
    axis.axhline(sd, color="#222222", lw=1, ls=":", label="sensor noise")
    axis.set_yscale("log")
    axis.set_xlabel("held-out window")
    axis.set_ylabel(f"error of {gain.channels[0].name} [{gain.channels[0].unit}]")
    figure.legend(loc="outside upper center", ncols=len(models) + 1)
    caption = (
        "Each group of bars is one held-out window; "
        "the dotted line is the sensor's own noise, the best that can be."
    )
    return Picture("before_after", "Before and after, window by window", caption, figure, pd.DataFrame(frame))


def parameters(diagnosis: Diagnosis, details: Details) -> Picture:
    """Refitted parameters against what the simulation assumed, with intervals."""
    rows = []
    for name, estimate in diagnosis.refit.items():
        centre, sd = details.priors[name]
        rows.append((name, centre, sd, estimate.value, estimate.low, estimate.high, estimate.unit))
    table = pd.DataFrame(rows, columns=["parameter", "assumed", "prior_sd", "value", "low", "high", "unit"])
    figure = Figure(figsize=(9.0, 0.32 * len(rows) + 1.2))
    axis = figure.subplots()
    shift = (table["value"] - table["assumed"]) / table["prior_sd"]
    low, high = ((table[k] - table["assumed"]) / table["prior_sd"] for k in ("low", "high"))
    axis.axvspan(-2, 2, color="#000000", alpha=0.06, lw=0)
    axis.errorbar(
        shift, range(len(rows)), xerr=[shift - low, high - shift], fmt="o", color=COLOURS["refit"], capsize=3
    )
    labels = [f"{r[0]} = {r[3]:.4g} {r[6]}" for r in rows]
    axis.set_yticks(range(len(rows)), labels)
    axis.set_ylim(-0.6, len(rows) - 0.4)
    axis.invert_yaxis()
    axis.set_xlabel("refitted minus assumed value, in standard deviations of the data sheet")
    caption = (
        "Parameters that the simulation already has, refitted to the log, with 95 % intervals; "
        "the band is what the data sheet allows."
    )
    return Picture("parameters", "The simulation's own parameters", caption, figure, table)


def _title(diagnosis: Diagnosis) -> str:
    names = [n.replace("_", " ") for n in diagnosis.names]
    return " and ".join(names) if all(kind_of(n.replace(" ", "_")) in CAUSES for n in names) else "the cause"

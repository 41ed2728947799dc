"""Error of the simulation over position and speed, without and with the named causes."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import LABELS, Layout, shown_models
from deepkoco.diagnose.report.figures.missing_figure import joint_shown, one_turn
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.output.picture import Picture

CELLS = 18  # of the map in each direction


def error_map(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Root mean square error of the position over position and speed, on the training windows."""
    joint = joint_shown(details)
    missing, windows, system = details.missing[joint], details.windows, details.system
    if joint not in windows.shows:
        return None
    channel = windows.shows.index(joint)
    fits = {"refit": details.refit}
    if "extended" in shown_models(diagnosis):
        fits["extended"] = details.final
    error = {name: _by_slot(fit, windows, channel, missing.theta.shape[1]) for name, fit in fits.items()}
    turning = system.state_units[joint] == "rad"
    x = one_turn(missing.theta) if turning else missing.theta
    y = missing.omega
    seen = np.isfinite(error["refit"]) & np.isfinite(x) & np.isfinite(y)
    if not seen.any():
        return None  # a gyro alone shows no position
    cells = {name: _cells(x[seen], y[seen], e[seen]) for name, e in error.items()}
    shown = np.concatenate([c[2][np.isfinite(c[2])] for c in cells.values()])
    scale = LogNorm(max(float(shown.min()), 1e-3 * float(shown.max()), 1e-12), max(float(shown.max()), 1e-11))
    rows, columns = layout.grid(len(fits))
    figure = Figure(figsize=(layout.width, 0.6 + 2.9 * rows))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    mesh = None
    for axis, (name, (across, up, mean)) in zip(axes.ravel(), cells.items(), strict=True):
        mesh = axis.pcolormesh(across, up, mean.T, norm=scale, cmap="viridis", rasterized=True)
        axis.set_title(LABELS[name])
        axis.grid(visible=False)
    of_joint = f" of {system.joint_names[joint]}" if system.own_joints > 1 else ""
    for axis in axes[-1]:
        what = f"angle{of_joint}, one turn" if turning else f"position{of_joint}"
        axis.set_xlabel(f"{what} [{system.state_units[joint]}]")
    for axis in axes[:, 0]:
        axis.set_ylabel(f"speed{of_joint} [{system.state_units[system.joints + joint]}]")
    assert mesh is not None
    name, unit = details.channels[channel]
    figure.colorbar(mesh, ax=axes, label=f"error of {name} [{unit}]")
    table = pd.DataFrame(
        {"position": x[seen], "speed": y[seen], **{f"error_{n}": e[seen] for n, e in error.items()}}
    )
    caption = (
        "Each cell is a region of position and speed. Its colour is the root mean square error of the simulation "
        "there: yellow is large, dark blue is small. The log has no samples in cells without colour."
    )
    return Picture("error_map", "Where the simulation is wrong", caption, figure, table)


def _by_slot(fit: Fit, windows: Windows, channel: int, slots: int) -> np.ndarray:
    """Root mean square error (W, slots) in each slot of a window, in the channel's unit; NaN without samples."""
    square = windows.errors(fit.residual)[:, channel].numpy() ** 2
    valid = windows.valid[:, channel].numpy()
    which = np.clip((windows.t[:, channel].numpy() / windows.length * slots).astype(int), 0, slots - 1)
    result = np.full((len(windows), slots), np.nan)
    for w in range(len(windows)):
        kept = which[w][valid[w]]
        count = np.bincount(kept, minlength=slots)
        total = np.bincount(kept, weights=square[w][valid[w]], minlength=slots)
        result[w, count > 0] = np.sqrt(total[count > 0] / count[count > 0])
    return result


def _cells(x: np.ndarray, y: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (C + 1,), (C + 1,) and the root mean square (C, C) of the errors in each cell, NaN where there are none."""
    edges = [np.linspace(v.min() - 1e-9, v.max() + 1e-9, CELLS + 1) for v in (x, y)]
    count, _, _ = np.histogram2d(x, y, bins=edges)
    total, _, _ = np.histogram2d(x, y, bins=edges, weights=error**2)
    return (
        edges[0],
        edges[1],
        np.sqrt(np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)),
    )

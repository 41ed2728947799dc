"""Missing load of the refitted simulation against speed, angle, command and time."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import COLOURS, Layout
from deepkoco.diagnose.report.text import spoken
from deepkoco.diagnose.residuals.missing_curve import expected_missing_torque
from deepkoco.diagnose.verdict.findings import motion_of
from deepkoco.output.picture import Picture


def missing_picture(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture:
    """Draw the missing load of the refitted baseline against speed, angle, command and time."""
    missing = details.missing[joint_shown(details)]
    system = details.system
    motion = motion_of(details.windows, missing, system)
    of_joint = f", {missing.name}" if system.own_joints > 1 else ""
    position, speed = system.state_units[missing.joint], system.state_units[system.joints + missing.joint]
    turning = position == "rad"
    load = missing.load
    command_unit = details.command_units[min(missing.joint, len(details.command_units) - 1)]
    torque = missing.torque.ravel()
    named = diagnosis.verdict in ("cause", "ambiguous") and details.final is not details.refit
    curve = expected_missing_torque(details, missing.joint).ravel() if named else None
    axes_of = {
        f"speed{of_joint} [{speed}]": motion.omega,
        f"angle{of_joint}, one turn [rad]" if turning else f"position{of_joint} [{position}]": (
            one_turn(motion.theta) if turning else motion.theta
        ),
        f"command{of_joint} [{command_unit}]": motion.command,
        "time [s]": motion.time,
    }
    rows, columns = (2, 2) if layout.columns > 1 else (4, 1)
    figure = Figure(figsize=(layout.width, 2.8 * rows if rows == 2 else 2.1 * rows + 0.7))
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    reach = float(np.quantile(np.abs(torque), 0.99)) * 1.3 + 1e-12
    for axis, (label, x) in zip(grid, axes_of.items(), strict=True):
        axis.plot(x, torque, ".", color=COLOURS["refit"], markersize=3, alpha=0.3, label=f"missing {load}")
        _binned(axis, x, torque, "-", COLOURS["refit"], "mean of the dots")
        if curve is not None:
            _binned(axis, x, curve, "--", COLOURS["extended"], "expected from the named cause")
        axis.set_xlabel(label)
        axis.set_ylim(-reach, reach)
    for axis in grid[::columns]:
        axis.set_ylabel(f"missing {load} [{missing.unit}]")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(3, layout.entries), markerscale=3)
    newton = "nm" if turning else "n"
    table = pd.DataFrame(
        {
            "time_s": motion.time,
            "angle_rad" if turning else "position_m": motion.theta,
            "speed_rad_s" if turning else "speed_m_s": motion.omega,
            "command": motion.command,
            f"missing_{load}_{newton}": torque,
            f"sd_{newton}": missing.sd.ravel(),
            f"named_cause_{newton}": curve if curve is not None else np.nan,
        }
    )
    caption = (
        f"Each dot is the extra {load} that would make the refitted simulation follow the measurement, averaged over a "
        "short time. If the dots scatter around zero without a pattern, nothing is missing."
    )
    if curve is not None:
        caption += (
            f" The dashed line is the pattern expected if {_title(diagnosis)} were the only cause. Where it "
        )
        caption += "follows the mean of the dots, the named cause explains them."
    return Picture("missing_torque", f"Missing {load} of the refitted simulation", caption, figure, table)


def joint_shown(details: Details) -> int:
    """Return the joint whose missing load is largest against its standard deviation."""
    changed = [float(((m.torque / m.sd) ** 2).mean()) for m in details.missing]
    return int(np.argmax(changed))


def one_turn(angle: np.ndarray) -> np.ndarray:
    """Angles [rad] brought into -pi to pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _binned(
    axis: Axes, x: np.ndarray, y: np.ndarray, style: str, colour: str, label: str, bins: int = 20
) -> None:
    """Draw the mean of y over bins of x with equal numbers of points."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, bins + 1)))
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    parts = [y[which == i] for i in range(len(edges) - 1)]
    kept = [i for i, part in enumerate(parts) if len(part)]
    centre = np.array([x[which == i].mean() for i in kept])
    mean = np.array([parts[i].mean() for i in kept])
    axis.plot(centre, mean, style, color=colour, lw=2.2, label=label)


def _title(diagnosis: Diagnosis) -> str:
    if all(kind_of(n) in CAUSES for n in diagnosis.names):
        return " and ".join(spoken(n) for n in diagnosis.names)
    return "the cause"

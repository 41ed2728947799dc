"""Files of a designed experiment: commands, expected likelihood ratios, and pictures with their tables."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deepkoco.diagnose.experiment_design.design import SETTLED, Design
from deepkoco.diagnose.experiment_design.rehearsal import acting_model
from deepkoco.output.new_folder import new_folder
from deepkoco.output.picture import Picture, house_style

COLOURS = ("#3b7dd8", "#e4572e", "#2a9d5c", "#8e5fc7")


def write_design(design: Design, out: str | Path) -> Path:
    """Write commands.csv, design.yaml and the pictures with their tables into a new folder.

    Returns:
        Path of commands.csv.

    Raises:
        FolderExistsError: The folder exists.
    """
    out = Path(out)
    with new_folder(out) as partial:
        command_table(design).to_csv(
            partial / "commands.csv", index=False, lineterminator="\n", float_format="%.8g"
        )
        (partial / "design.yaml").write_text(yaml.safe_dump(describe(design), sort_keys=False))
        with house_style():
            pictures = [_sequence(design), _outcome(design)]
        for picture in pictures:
            FigureCanvasAgg(picture.figure)
            picture.figure.savefig(partial / f"{picture.name}.png", metadata={"Software": None})
            picture.table.to_csv(
                partial / f"{picture.name}.csv", index=False, lineterminator="\n", float_format="%.8g"
            )
    return out / "commands.csv"


def command_table(design: Design) -> pd.DataFrame:
    """Return time [s] and every command in its unit, one row per tick; `deepkoco record --commands` plays it."""
    names = [c.name for c in design.stage.system.commands]
    return pd.DataFrame(
        {"t": design.stage.frame.time, **{n: design.sequence[:, k] for k, n in enumerate(names)}}
    )


def describe(design: Design) -> dict[str, Any]:
    """Return the content of design.yaml: causes, expected likelihood ratios, doses and setup."""
    stage, names = design.stage, design.causes
    system, frame, hold = stage.system, stage.frame, stage.hold
    document: dict[str, Any] = {
        "version": 1,
        "system": system.name,
        "distinguish": list(names),
        "maximised": (
            "smallest expected likelihood ratio over all ordered pairs of the causes, baseline and rival refitted"
        ),
        "settles": design.settles,
        "chance_to_tell_apart": _short(design.chance),
        "settled_from": SETTLED,
        "expected_likelihood_ratio": {
            f"{names[a]} against {names[b]}": _short(design.ratio[a, b]) for a, b in _pairs(design)
        },
        "to_first_order": {
            "nominal_unit": {
                f"{names[a]} against {names[b]}": _short(design.linear[a, b]) for a, b in _pairs(design)
            },
            "worst_of_drawn_units": _short(design.worst),
            "usual_sequences": {family: _short(value) for family, value in design.typical.items()},
            "log_at_hand": None if design.at_hand is None else _short(design.at_hand),
        },
        "seconds_needed": _short(design.seconds_needed),
        "doses": {
            dose.cause.name: {
                "strength": _short(s),
                **{n: {"value": _short(v), "unit": system.parameter(n).unit} for n, v in dose.values.items()},
            }
            for dose, s in zip(design.doses, design.strength, strict=True)
        },
        "family": design.family,
        "point": [_short(x) for x in design.point],
        "seconds": frame.seconds,
        "command_rate_hz": frame.rate,
        "sensor_rate_hz": stage.sensor_rate,
        "initial_state": dict(zip(system.state_names, map(_short, stage.initial), strict=True)),
        "limits": {
            **{
                c.name: list(map(_short, r))
                for c, r in zip(system.commands, stage.limits.command, strict=True)
            },
            **_finite_limits(design),
        },
        "feedback": None
        if hold is None
        else {
            "law": "command = value in commands.csv - gain (state - hold), then cut to the limits",
            "gain": [[_short(x) for x in row] for row in hold.gain],
            "hold": [_short(x) for x in hold.place],
        },
        "seed": design.seed,
    }
    return document


def _finite_limits(design: Design) -> dict[str, Any]:
    system, limits = design.stage.system, design.stage.limits
    joints = system.joints
    found = {
        name: list(map(_short, limits.position[j]))
        for j, name in enumerate(system.state_names[:joints])
        if np.isfinite(limits.position[j]).any()
    }
    speeds = zip(system.state_names[joints:], limits.speed, strict=True)
    return found | {name: [_short(-v), _short(v)] for name, v in speeds if np.isfinite(v)}


def _pairs(design: Design) -> list[tuple[int, int]]:
    return list(permutations(range(len(design.causes)), 2))


def _short(value: float) -> float | None:
    """Round to six digits; None for values that are not finite (no such sequence, no limit), which JSON lacks."""
    return float(f"{float(value):.6g}") if np.isfinite(value) else None


def _sequence(design: Design) -> Picture:
    stage, system = design.stage, design.stage.system
    table = command_table(design)
    figure = Figure(figsize=(9.0, 1.8 * len(system.commands) + 0.6))
    axes = np.atleast_1d(figure.subplots(len(system.commands), sharex=True))
    for k, (axis, channel) in enumerate(zip(axes, system.commands, strict=True)):
        axis.step(table["t"], table[channel.name], where="post", color="#222222", lw=1.0)
        for limit in stage.limits.command[k]:
            axis.axhline(limit, color="#9a9a9a", lw=0.8, ls=":")
        axis.set_ylabel(f"{channel.name} [{channel.unit}]")
    axes[-1].set_xlabel("time [s]")
    caption = "Commands to play; dotted: the limits."
    return Picture("sequence", f"The experiment ({design.family})", caption, figure, table)


def _outcome(design: Design) -> Picture:
    """Draw every channel under each cause, and the differences from the first cause."""
    stage, system = design.stage, design.stage.system
    channels = system.measurements
    figure = Figure(figsize=(9.0, 1.9 * len(channels) + 0.6))
    axes = figure.subplots(len(channels), 2, sharex=True, squeeze=False)
    time = design.rehearsals[0].time
    frame: dict[str, np.ndarray] = {"time_s": time}
    for i, name in enumerate(design.causes):
        shown = _sensed(design, i)
        for c, channel in enumerate(channels):
            key = f"{channel.name}_{name}_{channel.unit}"
            frame[key] = shown[:, c]
            axes[c, 0].plot(time, shown[:, c], color=COLOURS[i % len(COLOURS)], lw=1.0, label=name)
            if i:
                first = frame[f"{channel.name}_{design.causes[0]}_{channel.unit}"]
                axes[c, 1].plot(time, shown[:, c] - first, color=COLOURS[i % len(COLOURS)], lw=1.0)
    for c, channel in enumerate(channels):
        axes[c, 0].set_ylabel(f"{channel.name} [{channel.unit}]")
        axes[c, 1].axhspan(-stage.noise[c].sd, stage.noise[c].sd, color="#9a9a9a", alpha=0.3, lw=0)
    axes[0, 0].legend(fontsize="small")
    axes[0, 1].set_title(f"minus {design.causes[0]}; grey: sensor noise", fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    caption = (
        "Left: measurements expected under each cause. Right: their differences. A diagnosis refits parameters and "
        "initial states, so the differences that it finds are smaller than those drawn here."
    )
    return Picture("outcome", "Expected measurements", caption, figure, pd.DataFrame(frame))


def _sensed(design: Design, index: int) -> np.ndarray:
    """Return the measurements (T, N) along the simulated path with one cause."""
    played, stage = design.rehearsals[index], design.stage
    values = design.doses[index].on(stage.start.values)
    acting, named = acting_model(stage.system, [values])
    return acting.measure_at(torch.from_numpy(played.path[0]), torch.from_numpy(played.time), named).numpy()

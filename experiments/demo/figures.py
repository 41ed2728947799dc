"""The demo's own figures: how both controllers learned, and what they cost on the unit."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deepkoco.diagnose.report.figures.layout import COLOURS as MODELS
from deepkoco.output.picture import Picture, house_style
from deepkoco.runs.unit_trials import Trial

COLOURS = {name: MODELS[name] for name in ("baseline", "extended")}
SIMULATORS = {"baseline": "in the simulator as given", "extended": "in the extended simulator"}


def learning_curves(folder: Path) -> Picture:
    """Cost over the training episodes, a panel for each simulator.

    Args:
        folder: Of the demo.
    """
    tables = []
    with house_style():
        figure = Figure(figsize=(9.0, 3.4))
        panels = figure.subplots(1, 2)
        for panel, (name, colour) in zip(panels, COLOURS.items(), strict=True):
            rows = pd.read_csv(folder / "runs" / name / "metrics.csv")
            panel.plot(
                rows["episodes"], rows["train/cost"], ":", color=colour, label="with exploration noise"
            )
            panel.plot(
                rows["episodes"],
                rows["evaluation/cost"],
                "o-",
                markersize=3,
                color=colour,
                label="noise-free",
            )
            panel.set(title=f"trained and tested {SIMULATORS[name]}", yscale="log")
            panel.set(xlabel="training episodes", ylabel="cost of an episode")
            panel.legend()
            tables.append(rows[["episodes", "train/cost", "evaluation/cost"]].assign(policy=name))
    caption = (
        "Cost of an episode while each controller learned. The last noise-free point is of the weights that were kept. "
        "Do not compare the two panels: each cost is of another simulator, and the one that holds the cause is the "
        "harder one. What counts is the cost on the robot, above."
    )
    return Picture(
        "learning_curves", "How both learned, each in its own simulator", caption, figure, pd.concat(tables)
    )


def cost_on_unit(trials: Sequence[Trial], summary: Mapping[str, Any]) -> Picture:
    """Cost of every episode on the unit.

    Args:
        trials: The episodes.
        summary: Mean and interval of each policy.
    """
    with house_style():
        figure = Figure(figsize=(9.0, 2.6))
        axes = figure.subplots()
        costs = {n: [t.cost for t in trials if t.policy == n] for n in COLOURS}
        for position, (name, values) in enumerate(costs.items()):
            spread = np.linspace(-0.18, 0.18, len(values))
            axes.scatter(values, position + spread, s=14, color=COLOURS[name], alpha=0.6)
            row = summary[name]
            error = [[row["mean"] - row["low"]], [row["high"] - row["mean"]]]
            axes.errorbar(row["mean"], position, xerr=error, fmt="D", color="#222222", capsize=5, zorder=3)
        ticks = [text.replace("in the ", "in the\n") for text in SIMULATORS.values()]
        axes.set_yticks(range(len(costs)), [f"trained {text}" for text in ticks])
        axes.set(xlabel="cost of an episode on the robot", ylim=(1.5, -0.5))
        axes.grid(axis="y", visible=False)
    table = pd.DataFrame(
        [(t.policy, t.episode, t.cost) for t in trials], columns=["policy", "episode", "cost"]
    )
    caption = (
        "Each dot is an episode on the robot; the diamond is the mean with its 95 % interval. Less is better."
    )
    return Picture("cost_on_unit", "Every episode on the robot", caption, figure, table)


def save(picture: Picture, folder: Path) -> None:
    """Write a picture as PNG and CSV."""
    buffer = io.BytesIO()
    FigureCanvasAgg(picture.figure)
    with house_style():
        picture.figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    (folder / f"{picture.name}.png").write_bytes(buffer.getvalue())
    picture.table.to_csv(folder / f"{picture.name}.csv", index=False)

"""The demo's page and table: what was found, and what it was worth on the unit."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import jinja2
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from rich.table import Table

from deepkoco.diagnose import Diagnosis
from deepkoco.diagnose.report.text import headline, lead
from deepkoco.envs.film import film_strip
from deepkoco.output.whole_file import write_whole_text
from deepkoco.runs.unit_trials import Trial

COLOURS = {"baseline": "#b5483a", "extended": "#26547c"}
LABELS = {"baseline": "trained in the simulator as given", "extended": "trained in the extended simulator"}
# Pictures of the diagnosis that the page shows, in this order, with the question each answers.
FIGURES = {
    "replay": "What does the simulation get wrong?",
    "missing_torque": "Which torque is missing, and when?",
    "candidates": "Which cause explains it?",
    "error_by_horizon": "How far ahead does the simulation hold, before and after?",
}


@dataclass(frozen=True)
class Outcome:
    """Everything that the demo found.

    Attributes:
        diagnosis: Of the recorded log.
        trials: Episodes on the unit.
        summary: Costs on the unit by policy, with intervals.
        folder: Where the demo writes.
        seconds: Time it took.
    """

    diagnosis: Diagnosis
    trials: Sequence[Trial]
    summary: dict[str, Any]
    folder: Path
    seconds: float


def terminal_table(outcome: Outcome) -> Table:
    """What the page says, in a few lines."""
    table = Table(
        title=headline(outcome.diagnosis), title_justify="left", show_header=True, header_style="bold"
    )
    table.add_column("")
    table.add_column("before")
    table.add_column("after")
    for name, estimate in _parameters(outcome.diagnosis).items():
        text = f"{estimate.value:.4g} [{estimate.low:.4g}, {estimate.high:.4g}] {estimate.unit}"
        table.add_row(name.replace("_", " ").replace(".", ": "), "not in the simulator", text)
    gain = outcome.diagnosis.gain
    if gain is not None:
        for channel in gain.channels:
            table.add_row(
                f"held-out error of {channel.name} [{channel.unit}]",
                f"{channel.baseline:.3g} as given, {channel.refit:.3g} refitted",
                f"{channel.extended:.3g}",
            )
    rows = [outcome.summary[name] for name in COLOURS]
    table.add_row("mean cost on the unit", *(_interval(row) for row in rows))
    table.add_row(
        "upright at the end", *(f"{100 * row['upright']:.0f} % of {row['episodes']}" for row in rows)
    )
    saved = rows[1]["saved_against_first"]
    table.add_row("saved, same starts", "", _interval(saved))
    table.add_row("time", "", f"{outcome.seconds / 60:.1f} min")
    return table


def write_page(outcome: Outcome) -> Path:
    """Write index.html, self-contained, and its own figures beside it.

    Returns:
        Path of the page.
    """
    figures = {
        "learning_curves": _learning_curves(outcome.folder),
        "cost_on_unit": _cost_on_unit(outcome),
    }
    films = {name: _film(outcome.folder / "unit" / f"{name}.webm") for name in COLOURS}
    source = (Path(__file__).parent / "page.html").read_text(encoding="utf-8")
    saved = outcome.summary["extended"]["saved_against_first"]
    page = (
        jinja2.Environment(autoescape=True)
        .from_string(source)
        .render(
            headline=headline(outcome.diagnosis),
            lead=lead(outcome.diagnosis),
            parameters=_parameters(outcome.diagnosis),
            gain=outcome.diagnosis.gain,
            figures=[
                {"title": title, "png": _encoded((outcome.folder / "diagnosis" / f"{name}.png").read_bytes())}
                for name, title in FIGURES.items()
                if (outcome.folder / "diagnosis" / f"{name}.png").exists()
            ],
            own={name: _encoded(png) for name, png in figures.items()},
            films=films,
            labels=LABELS,
            costs={name: _interval(outcome.summary[name]) for name in COLOURS},
            upright={name: f"{100 * outcome.summary[name]['upright']:.0f} %" for name in COLOURS},
            episodes=outcome.summary["extended"]["episodes"],
            saved=_interval(saved),
            better=saved["low"] > 0,
            minutes=f"{outcome.seconds / 60:.1f}",
        )
    )
    path = outcome.folder / "index.html"
    write_whole_text(path, page)
    return path


def _parameters(diagnosis: Diagnosis) -> dict[str, Any]:
    return {name: e for cause in diagnosis.causes for name, e in cause.parameters.items()}


def _interval(row: dict[str, Any]) -> str:
    if math.isnan(row["low"]):  # a single episode
        return f"{row['mean']:.0f}"
    return f"{row['mean']:.0f} [{row['low']:.0f}, {row['high']:.0f}]"


def _encoded(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _save(figure: Figure, folder: Path, name: str, table: pd.DataFrame) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, bbox_inches="tight")
    plt.close(figure)
    (folder / f"{name}.png").write_bytes(buffer.getvalue())
    table.to_csv(folder / f"{name}.csv", index=False)
    return buffer.getvalue()


def _learning_curves(folder: Path) -> bytes:
    figure, axes = plt.subplots(figsize=(6.4, 3.4))
    tables = []
    for name, colour in COLOURS.items():
        rows = pd.read_csv(folder / "runs" / name / "metrics.csv")
        axes.plot(rows["episodes"], rows["train/cost"], ":", color=colour, alpha=0.7)
        axes.plot(rows["episodes"], rows["evaluation/cost"], color=colour, label=LABELS[name])
        tables.append(rows[["episodes", "train/cost", "evaluation/cost"]].assign(policy=name))
    axes.set(xlabel="training episodes", ylabel="cost of an episode", yscale="log")
    axes.set_title(
        "dotted: with exploration noise; solid: noise-free, last point: the weights kept; each in its own simulator",
        fontsize=8,
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return _save(figure, folder, "learning_curves", pd.concat(tables))


def _cost_on_unit(outcome: Outcome) -> bytes:
    figure, axes = plt.subplots(figsize=(6.4, 3.0))
    costs = {n: [t.cost for t in outcome.trials if t.policy == n] for n in COLOURS}
    for position, (name, values) in enumerate(costs.items()):
        spread = np.linspace(-0.18, 0.18, len(values))
        axes.scatter(values, position + spread, s=14, color=COLOURS[name], alpha=0.6)
        row = outcome.summary[name]
        error = [[row["mean"] - row["low"]], [row["high"] - row["mean"]]]
        axes.errorbar(row["mean"], position, xerr=error, fmt="D", color="black", capsize=5, zorder=3)
    axes.set_yticks(range(len(costs)), [LABELS[name].replace("trained in", "trained in\n") for name in costs])
    axes.set(xlabel="cost of an episode on the unit (diamond: mean with 95 % interval)", ylim=(1.5, -0.5))
    axes.grid(axis="x", alpha=0.3)
    table = pd.DataFrame(
        [(t.policy, t.episode, t.cost) for t in outcome.trials], columns=["policy", "episode", "cost"]
    )
    return _save(figure, outcome.folder, "cost_on_unit", table)


def _film(path: Path) -> dict[str, str]:
    """The clip, and its frames as a strip, for the page."""
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        there, frame = capture.read()
        if not there:
            break
        frames.append(frame)
    capture.release()
    strip = film_strip(frames[: len(frames) // 2], count=9)
    _, png = cv2.imencode(".png", strip)
    path.with_suffix(".png").write_bytes(png.tobytes())
    return {"clip": _encoded(path.read_bytes()), "strip": _encoded(png.tobytes())}

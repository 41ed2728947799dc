"""The demo's page and table: what was found, and what it was worth on the unit."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.table import Table

from deepkoco.diagnose import Diagnosis
from deepkoco.diagnose.report.figures.all_figures import draw_all
from deepkoco.diagnose.report.figures.layout import COLOURS as MODELS
from deepkoco.diagnose.report.figures.layout import DESKTOP, PHONE
from deepkoco.diagnose.report.next_steps import next_steps
from deepkoco.diagnose.report.parameter_table import interval
from deepkoco.diagnose.report.text import headline, lead
from deepkoco.envs.film import film_strip
from deepkoco.output.whole_file import write_whole_text
from deepkoco.pages import (
    Shown,
    in_one_unit,
    less,
    link_pages,
    links_between,
    readable,
    render_page,
    show_both,
    software,
)
from deepkoco.runs.unit_trials import Trial
from experiments.demo.figures import cost_on_unit, learning_curves, save

COLOURS = {name: MODELS[name] for name in ("baseline", "extended")}
LABELS = {"baseline": "trained in the simulator as given", "extended": "trained in the extended simulator"}
# Pictures of the diagnosis that the page shows, in this order, with the question each answers.
FIGURES = {
    "replay": "What does the simulation get wrong?",
    "missing_torque": "Which torque is missing, and when?",
    "candidates": "Which cause explains it?",
    "error_by_horizon": "How far ahead does the simulation hold, before and after?",
}
FRAMES = 9  # of each film, as stills
PERIOD = 0.05  # between two frames [s]
AMONG = {
    "none": "",
    "copies": ", among copies of itself that have nothing to do with the task",
    "noise": ", among noise that has nothing to do with the task",
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
        distractors: What else the controllers saw.
    """

    diagnosis: Diagnosis
    trials: Sequence[Trial]
    summary: dict[str, Any]
    folder: Path
    seconds: float
    distractors: str = "none"


def pages_of(folder: Path) -> dict[str, Path]:
    """The pages of a demo, in the order in which they are read."""
    return {
        "Demo": folder / "index.html",
        "Diagnosis": folder / "diagnosis" / "report.html",
        "Model": folder / "runs" / "extended" / "analysis.html",
        "Graph": folder / "graph.html",
    }


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


def write_page(outcome: Outcome, made: date | None = None) -> Path:
    """Write index.html, self-contained, and its own figures beside it; link it with the pages that are there.

    Args:
        outcome: What was found.
        made: Day that the page says; None takes today's, or that of SOURCE_DATE_EPOCH.

    Returns:
        Path of the page.
    """
    folder, diagnosis, pages = outcome.folder, outcome.diagnosis, pages_of(outcome.folder)
    own = {"learning": learning_curves(folder), "cost_on_unit": cost_on_unit(outcome.trials, outcome.summary)}
    for picture in own.values():
        save(picture, folder)
    saved = outcome.summary["extended"]["saved_against_first"]
    costs = {name: _interval(outcome.summary[name]) for name in COLOURS}
    page = render_page(
        "experiments.demo",
        "page.html",
        title="DeepKoCo demo",
        versions=software("torch", "numpy"),
        made=made,
        links=links_between(pages["Demo"], pages),
        headline=headline(diagnosis),
        lead=lead(diagnosis),
        tiles=_tiles(outcome, costs),
        figures=_diagnosed(diagnosis),
        films={name: _film(folder / "unit" / f"{name}.webm") for name in COLOURS},
        labels=LABELS,
        costs=costs,
        upright={name: f"{100 * outcome.summary[name]['upright']:.0f} %" for name in COLOURS},
        among=AMONG.get(outcome.distractors, f", among distractors ({outcome.distractors})"),
        saved=_interval(saved),
        better=saved["low"] > 0,
        steps=[
            {
                "text": "Diagnose a log of it.",
                "command": "deepkoco diagnose LOG.csv --system SYSTEM --out report",
            },
            *(step._asdict() for step in next_steps(diagnosis, "report")),
        ],
        minutes=f"{outcome.seconds / 60:.1f}",
        **{name: show_both(picture, f"{picture.name}.csv") for name, picture in own.items()},
    )
    path = pages["Demo"]
    write_whole_text(path, page)
    link_pages(pages)
    return path


def _tiles(outcome: Outcome, costs: dict[str, str]) -> list[dict[str, str]]:
    tiles = []
    for name, e in _parameters(outcome.diagnosis).items():
        said = name.replace("_", " ").replace(".", ": ")
        tiles.append({"value": readable(e.value, e.unit), "text": f"{said}, 95 % interval {interval(e)}"})
    gain = outcome.diagnosis.gain
    if gain is not None:
        c = gain.channels[0]
        (before, after), unit = in_one_unit([c.baseline, c.extended], c.unit)
        text = (
            f"error of the simulated {c.name} on data that no fit has seen, over {gain.horizon:.2g} s: "
            f"{before} {unit} before, {after} {unit} after"
        )
        tiles.append({"value": f"{less(c.baseline, c.extended)} error", "text": text})
    episodes = outcome.summary["extended"]["episodes"]
    text = f"mean cost on the robot with its 95 % interval, {episodes} episodes each"
    return [*tiles, {"value": f"{costs['baseline']} → {costs['extended']}", "text": text}]


def _diagnosed(diagnosis: Diagnosis) -> list[Shown]:
    """The pictures of the diagnosis that the demo shows, each under the question that it answers."""
    wide = {p.name: p for p in draw_all(diagnosis, DESKTOP)}
    phone = {p.name: p for p in draw_all(diagnosis, PHONE)}
    return [
        show_both(wide[name]._replace(title=title), f"diagnosis/{name}.csv", phone[name])
        for name, title in FIGURES.items()
        if name in wide
    ]


def _parameters(diagnosis: Diagnosis) -> dict[str, Any]:
    return {name: e for cause in diagnosis.causes for name, e in cause.parameters.items()}


def _interval(row: dict[str, Any]) -> str:
    if math.isnan(row["low"]):  # a single episode
        return f"{row['mean']:.0f}"
    return f"{row['mean']:.0f} [{row['low']:.0f}, {row['high']:.0f}]"


def _film(path: Path) -> dict[str, Any]:
    """The clip, and stills of its first half, for the page; a strip of them lies beside the clip."""
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        there, frame = capture.read()
        if not there:
            break
        frames.append(frame)
    capture.release()
    half = frames[: max(len(frames) // 2, 1)]
    cv2.imwrite(str(path.with_suffix(".png")), film_strip(half, count=FRAMES))
    shown = np.unique(np.linspace(0, len(half) - 1, FRAMES).round().astype(int))
    stills = [{"time": f"{PERIOD * i:.2g} s", "png": _still(half[i])} for i in shown]
    return {"clip": base64.b64encode(path.read_bytes()).decode(), "frames": stills}


def _still(frame: np.ndarray) -> str:
    _, png = cv2.imencode(".png", frame)
    return base64.b64encode(png.tobytes()).decode()

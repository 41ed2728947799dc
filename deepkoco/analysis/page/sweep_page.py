"""One static page for a sweep: learning curves, final costs, and a way to every run."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.output.picture import Picture, house_style
from deepkoco.output.whole_file import write_whole_text
from deepkoco.pages import Shown, render_page, show_both, software
from deepkoco.pages.links import relative
from deepkoco.pages.units import rounded

# Told apart by people who do not see all colours, as in deepkoco.graph.drawing.style.
COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#a89f00",
    "#332288",
    "#882255",
    "#44aa99",
)
FEW = 5
"""Seeds below which an interval is the range of the seeds: their lowest and highest cost."""
MOST_LETTERS = 48  # of a name in one line of a figure
CURVES = {"train/cost": "training, with exploration noise", "evaluation/cost": "noise-free"}
PAGE = "index.html"


def write_sweep_page(
    folder: Path,
    curves: pd.DataFrame,
    final: pd.DataFrame,
    table: pd.DataFrame,
    title: str,
    place: Path | None = None,
    made: date | None = None,
) -> Path:
    """Write index.html into the folder of a sweep's summary, beside curves.csv, final.csv and table.csv.

    Args:
        folder: Where to.
        curves: Columns condition, curve (a key of `CURVES`), episodes, iqm, low, high, seeds.
        final: Last row of each run: condition, seed, run (its folder), episodes, evaluation/cost, seconds.
        table: A row for each condition: condition, n, iqm, low, high, mean, best, worst.
        title: Heading.
        place: Where the folder will lie in the end, for links; None: where it is.
        made: Day that the page says; None takes today's, or that of SOURCE_DATE_EPOCH.

    Returns:
        Path of the page.
    """
    page = (place or folder) / PAGE
    few = bool((table["n"] < FEW).any())
    best = final.loc[final["evaluation/cost"].idxmin()]
    text = render_page(
        "deepkoco.analysis.page",
        "sweep_page.html",
        title=title,
        versions=software("torch", "numpy"),
        made=made,
        lead=_lead(final, table, few),
        tiles=_tiles(table),
        pictures=draw_sweep(curves, final, table, few),
        table=[_condition(row) for row in table.to_dict("records")],
        runs=[_run(row, page) for row in final.to_dict("records")],
        steps=[
            {"text": "See what the best run has learned.", "command": f"deepkoco show {best['run']}"},
            {
                "text": "Measure it on more episodes.",
                "command": f"deepkoco evaluate run={best['run']} episodes=200",
            },
        ],
    )
    write_whole_text(folder / PAGE, text)
    return folder / PAGE


def draw_sweep(curves: pd.DataFrame, final: pd.DataFrame, table: pd.DataFrame, few: bool) -> list[Shown]:
    """The figures of a sweep; arguments as for `write_sweep_page`, and whether there are few seeds."""
    colours = {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(table["condition"])}
    band = "Bands and bars are 95 % bootstrap intervals over seeds."
    if few:
        band += f" For fewer than {FEW} seeds they show the lowest and the highest cost."
    with house_style():
        pictures = [_learning(curves, colours, band), _final(final, table, colours, band)]
        numbers = ("curves.csv", "final.csv")
        return [show_both(p, file) for p, file in zip(pictures, numbers, strict=True)]


def _learning(curves: pd.DataFrame, colours: dict[str, str], band: str) -> Picture:
    lines = sum(_wrapped(name).count("\n") + 1 for name in colours)
    figure = Figure(figsize=(9.0, 3.4 + 0.1 * lines))
    panels = figure.subplots(1, len(CURVES), sharey=True)
    for axes, (curve, title) in zip(panels, CURVES.items(), strict=True):
        for condition, colour in colours.items():
            rows = curves[(curves["curve"] == curve) & (curves["condition"] == condition)]
            axes.plot(
                rows["episodes"], rows["iqm"], "o-", markersize=3, color=colour, label=_wrapped(condition)
            )
            axes.fill_between(rows["episodes"], rows["low"], rows["high"], color=colour, alpha=0.2, lw=0)
        axes.set(title=title, xlabel="training episodes", ylim=(0.0, None))
    panels[0].set_ylabel("cost of an episode")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    caption = (
        f"Interquartile mean over seeds of the cost of an episode, while the controllers learned. {band}"
    )
    return Picture("learning_curve", "How they learned", caption, figure, curves)


def _final(final: pd.DataFrame, table: pd.DataFrame, colours: dict[str, str], band: str) -> Picture:
    lines = max(_wrapped(name).count("\n") + 1 for name in table["condition"])
    figure = Figure(figsize=(9.0, 1.0 + (0.55 + 0.16 * lines) * len(table)))
    axes = figure.subplots()
    for place, row in enumerate(table.to_dict("records")):
        costs = final.loc[final["condition"] == row["condition"], "evaluation/cost"].to_numpy()
        spread = np.linspace(-0.15, 0.15, len(costs)) if len(costs) > 1 else np.zeros(1)
        axes.plot(costs, place + spread, "o", markersize=4, alpha=0.6, color=colours[row["condition"]])
        error = [[max(row["iqm"] - row["low"], 0.0)], [max(row["high"] - row["iqm"], 0.0)]]
        shown = None if math.isnan(row["low"]) else error
        axes.errorbar(row["iqm"], place, xerr=shown, fmt="D", color="#222222", capsize=4, zorder=3)
        # Names may be long: they stand above their row, not beside it.
        name = _wrapped(row["condition"])
        axes.text(
            0.01, place - 0.25, name, transform=axes.get_yaxis_transform(), va="bottom", fontsize=9, zorder=4
        )
    axes.set_yticks([])
    axes.set(xlabel="final cost of an episode", ylim=(len(table) - 0.5, -0.3 - 0.5 * lines))
    axes.grid(axis="y", visible=False)
    caption = f"Each dot is a run, the diamond the interquartile mean over seeds. Less is better. {band}"
    return Picture("final_cost", "Where they ended", caption, figure, final)


def _wrapped(name: str) -> str:
    """A name of a group in lines that a phone can show."""
    return textwrap.fill(name, MOST_LETTERS)


def _lead(final: pd.DataFrame, table: pd.DataFrame, few: bool) -> str:
    runs, groups = f"{len(final)} finished run{'s' * (len(final) != 1)}", len(table)
    if groups == 1:
        return f"{runs} that differ in nothing but the seed."
    text = f"{runs} in {groups} groups; within a group, runs differ in nothing but the seed."
    return f"{text} With so few seeds, small differences mean nothing." if few else text


def _tiles(table: pd.DataFrame) -> list[dict[str, str]]:
    best = table.loc[table["iqm"].idxmin()]
    said = f"lowest cost of an episode (interquartile mean of {best['n']} seeds): {best['condition']}"
    return [
        {"value": rounded(float(best["iqm"])), "text": said},
        {"value": rounded(float(best["best"])), "text": "cost of the best single run among them"},
    ]


def _condition(row: dict[str, Any]) -> dict[str, str]:
    interval = f"{rounded(row['low'])} to {rounded(row['high'])}" if row["n"] >= FEW else "too few seeds"
    return {
        "condition": row["condition"],
        "seeds": str(row["n"]),
        "iqm": rounded(row["iqm"]),
        "interval": interval,
        "mean": rounded(row["mean"]),
        "spread": f"{rounded(row['best'])} to {rounded(row['worst'])}",
    }


def _run(row: dict[str, Any], page: Path) -> dict[str, str]:
    folder = Path(row["run"])
    target = next((path for path in _targets(folder) if path.exists()), None)
    return {
        "name": folder.name if folder.name != str(row["seed"]) else f"{folder.parent.name}/{folder.name}",
        "href": "" if target is None else relative(target, page),
        "condition": row["condition"],
        "seed": str(row["seed"]),
        "cost": rounded(row["evaluation/cost"]),
        "episodes": f"{row['episodes']:.0f}",
        "time": f"{row['seconds'] / 60:.1f} min" if row["seconds"] >= 60 else f"{row['seconds']:.0f} s",
    }


def _targets(run: Path) -> Sequence[Path]:
    """What a run is shown by, the best first."""
    return run / "analysis.html", run

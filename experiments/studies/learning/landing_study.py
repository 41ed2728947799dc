"""Landings of a quadrotor on a moving, inclined deck, with and without delays in the training.

    python -m experiments.studies.learning.landing_study --out results/inclined_landing --seeds 0 1 2 3 4 \\
        --kinds by_hand

Each seed has a hidden unit of its own, which is identified first. One run after the other, each in a process of its own
with one thread; a stopped study goes on where it was. Writes a row for each run, one for each landing, maps of the
success over incline and speed, and a film.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.envs.film import write_clip
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import writing
from deepkoco.runs.settings import ExperimentError
from deepkoco.systems.landing.landing_picture import draw_landing
from experiments.plumbing.own_process import run_once
from experiments.plumbing.provenance import as_markdown
from experiments.studies.diagnosis.hidden.measures import wilson
from experiments.studies.learning.landing_runs import FILMED, KINDS, LEVEL, METHODS

RUNS = "experiments.studies.learning.landing_runs"
LABELS = {
    LEVEL: "level",
    "guided_without": "guided, knows no delay",
    "guided_delays": "guided, knows the delays",
    "without": "trained without delays",
    "delays": "trained with delays",
}
SIZE, FPS = 240, 25
SHOWN = 6  # pictures of a strip


def tables(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """All runs of a folder: a row for each training, and one for each landing.

    Args:
        folder: Of the results.
    """
    runs, landings = [], []
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        for method, way in run["ways"].items():
            landings += [{"method": method, "seed": run["seed"], **row} for row in way["landings"]]
            training = way["training"]
            own = {"cost": training["cost"], "steps": training["steps"]}
            runs.append({**run, "method": method, **own, "training_cpu_seconds": training["cpu_seconds"]})
    columns = [
        "method",
        "seed",
        "cost",
        "steps",
        "training_cpu_seconds",
        "fit_cpu_seconds",
        "cpu_seconds",
        "commit",
    ]
    found = pd.DataFrame(landings)
    if len(found):
        found.insert(2, "incline_deg", np.degrees(found.pop("incline")).round(3))
        found["tilt_deg"] = np.degrees(found.pop("tilt"))
    return pd.DataFrame(runs, columns=columns), found


def success_map(landings: pd.DataFrame) -> pd.DataFrame:
    """Successes of all seeds by method, incline and speed, with their share and its 95 % interval of Wilson.

    Args:
        landings: A row for each landing.
    """
    hits: dict[tuple[str, float, float], list[bool]] = {}
    for row in landings[["method", "incline_deg", "speed", "success"]].itertuples(index=False, name=None):
        hits.setdefault(row[:3], []).append(row[3])
    names = ("method", "incline_deg", "speed")
    return pd.DataFrame([{**dict(zip(names, key, strict=True)), **wilson(own)} for key, own in hits.items()])


def draw_maps(cells: pd.DataFrame) -> Figure:
    """Share of landings over incline and speed, a panel for each way.

    Args:
        cells: As from `success_map`.
    """
    with house_style():
        ways = [method for method in LABELS if method in set(cells["method"])]
        size = (1.0 + 3.4 * len(ways), 3.6)
        figure, grid = plt.subplots(
            1, len(ways), figsize=size, sharey=True, layout="constrained", squeeze=False
        )
        panels, image = grid[0], None
        for panel, method in zip(panels, ways, strict=True):
            own = cells[cells["method"] == method]
            table = own.pivot_table(index="incline_deg", columns="speed", values="share")
            image = panel.imshow(
                table.to_numpy(), origin="lower", vmin=0.0, vmax=1.0, cmap="viridis", aspect="auto"
            )
            panel.grid(visible=False)
            for (i, j), share in np.ndenumerate(table.to_numpy()):
                colour = "black" if share > 0.6 else "white"
                panel.text(j, i, f"{100 * share:.0f}", ha="center", va="center", color=colour, fontsize=8)
            panel.set_xticks(range(len(table.columns)), [f"{v:g}" for v in table.columns])
            panel.set_yticks(range(len(table.index)), [f"{v:g}" for v in table.index])
            panel.set_xlabel("speed of the deck [m/s]")
            panel.set_title(LABELS[method], fontsize=9)
        panels[0].set_ylabel("incline [degrees]")
        if image is not None:
            figure.colorbar(image, ax=panels, label="share of landings")
    return figure


def films_of(folder: Path, seed: int) -> dict[str, dict[str, np.ndarray]]:
    """The filmed flights of a unit by way: of each step (T) and deck (K) what `landing_runs` stored.

    Args:
        folder: Of the results.
        seed: Of the unit.
    """
    stored: dict = {}
    for path in sorted(folder.glob(f"*_{seed}.json")):
        stored |= {name: way["film"] for name, way in json.loads(path.read_text())["ways"].items()}
    stored = {name: stored[name] for name in LABELS if name in stored}
    return {name: {k: np.array(v, float) for k, v in own.items()} for name, own in stored.items()}


def frames(films: dict[str, dict[str, np.ndarray]]) -> list[np.ndarray]:
    """A film: a row for each way, a column for each deck; a flight that has ended stands still.

    Args:
        films: As from `films_of`.
    """
    longest = max(len(film["place"]) for film in films.values())
    pictures = []
    for step in range(0, longest, 2):
        rows = [
            np.concatenate([_frame(film, step, column) for column in range(len(FILMED))], 1)
            for film in films.values()
        ]
        pictures.append(np.concatenate(rows, 0))
    return pictures + [pictures[-1]] * FPS


def draw_strip(films: dict[str, dict[str, np.ndarray]], column: int) -> Figure:
    """Pictures of the flights over one deck, a row for each way, until each has touched or two seconds have passed.

    Args:
        films: As from `films_of`.
        column: Which of the decks.
    """
    with house_style():
        figure, panels = plt.subplots(len(films), SHOWN, figsize=(1.6 * SHOWN, 5.0), layout="constrained")
        for row, (method, film) in zip(panels, films.items(), strict=True):
            touched = film["touched"][:, column] > 0.5
            last = int(np.argmax(touched)) if touched.any() else min(100, len(touched) - 1)
            for panel, step in zip(row, np.linspace(0, last, SHOWN).round().astype(int), strict=True):
                panel.imshow(_frame(film, step, column))
                panel.set_title(f"{0.02 * step:.2f} s", fontsize=7)
                panel.set_xticks([])
                panel.set_yticks([])
                panel.grid(visible=False)
            row[0].set_ylabel(LABELS[method], fontsize=7)
    return figure


def _frame(film: dict[str, np.ndarray], step: int, column: int) -> np.ndarray:
    touched = film["touched"][:, column] > 0.5
    # A touch-down is the end: the motion after it has no meaning.
    last = int(np.argmax(touched)) if touched.any() else len(touched) - 1
    k = min(step, last)
    place, deck = film["place"][k, column], film["deck"][k, column]
    return draw_landing(
        place - deck, film["axis"][k, column], film["normal"][k, column], deck[:2], bool(touched[k]), SIZE
    )


def summary(runs: pd.DataFrame, landings: pd.DataFrame) -> str:
    """Tables in Markdown: landings by way and range, what failed, and what the runs took.

    Args:
        runs: A row for each training.
        landings: A row for each landing.
    """
    ranges = {"all": landings["incline_deg"] >= 0.0}
    ranges["to 10 degrees"] = landings["incline_deg"] <= 10.0
    ranges["25 degrees"] = landings["incline_deg"] == 25.0
    ranges["25 degrees, 1 m/s"] = ranges["25 degrees"] & (landings["speed"] == 1.0)
    lines = ["| | " + " | ".join(ranges) + " |", "|---|" + "---|" * len(ranges)]
    ways = {method: text for method, text in LABELS.items() if method in set(landings["method"])}
    for method, text in ways.items():
        cells = []
        for where in ranges.values():
            own = landings[where & (landings["method"] == method)]
            if own.empty:
                cells.append("")
                continue
            found = wilson(own["success"].tolist())
            seeds = [float(np.mean(rows["success"])) for _, rows in own.groupby("seed")]
            spread = f"seeds {min(seeds):.2f} to {max(seeds):.2f}"
            cells.append(f"{found['share']:.2f} [{found['low']:.2f}, {found['high']:.2f}], {spread}")
        lines.append(f"| {text} | {' | '.join(cells)} |")
    lines += [
        "",
        "| | touched | offset [m] | sink [m/s] | slip [m/s] | tilt [deg] | time [s] |",
        "|---|---|---|---|---|---|---|",
    ]
    for method, text in ways.items():
        own = landings[landings["method"] == method]
        touched = own[own["touched"]]
        medians = [
            "{:.2f} ({:.2f})".format(*np.nanquantile(np.asarray(touched[name], float), (0.5, 0.9)))
            for name in ("offset", "sink", "slip", "tilt_deg", "time")
        ]
        share = np.mean(np.asarray(own["touched"], float))
        lines.append(f"| {text}: median (nine of ten below) | {share:.2f} | {' | '.join(medians)} |")
    lines.append("")
    for method, rows in runs[runs["method"].isin(METHODS)].groupby("method"):
        seconds = rows["training_cpu_seconds"]
        lines.append(f"{method}: {seconds.min():.0f} to {seconds.max():.0f} processor seconds a training")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Landings of a quadrotor, trained with and without delays.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--kinds", choices=KINDS, nargs="+", default=list(KINDS))
    parser.add_argument(
        "--training", type=int, default=None, help="episodes of a training; default: as stored"
    )
    args = parser.parse_args(arguments)
    options = [] if args.training is None else ["--training", f"{args.training}"]
    folder = args.out / "runs"
    try:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        for seed in args.seeds:
            for kind in args.kinds:
                run_once(RUNS, kind, seed, folder, options)
                print(f"{kind}, seed {seed}", flush=True)
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    runs, landings = tables(folder)
    runs.to_csv(args.out / "runs.csv", index=False, float_format="%.3f")
    landings.to_csv(args.out / "landings.csv", index=False, float_format="%.4f")
    cells = success_map(landings)
    cells.to_csv(args.out / "success.csv", index=False, float_format="%.4f")
    (args.out / "success.png").write_bytes(as_png(draw_maps(cells)))
    plt.close("all")
    films = films_of(folder, args.seeds[0])
    (args.out / "film.png").write_bytes(as_png(draw_strip(films, len(FILMED) - 1)))
    (args.out / "film.webm").unlink(missing_ok=True)
    write_clip(args.out / "film.webm", frames(films), FPS)
    print(summary(runs, landings), as_markdown(), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

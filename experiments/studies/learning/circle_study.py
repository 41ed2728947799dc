"""Circles of a quadrotor, with and without delays in the training (Table 4.3 of the thesis).

    python -m experiments.studies.learning.circle_study --out results/circle_following --seeds 0 1 2 3 4

Each seed has a hidden unit of its own, which is identified first. One run after the other, each in a process of its own
with one thread; a stopped study goes on where it was. Writes a row for each run, one for each flight condition, a
figure of the errors and one of flights.
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

from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import writing
from deepkoco.runs.settings import ExperimentError
from experiments.plumbing.own_process import run_once
from experiments.plumbing.provenance import as_markdown
from experiments.studies.learning.circle_runs import CIRCLES, FURTHER

RUNS = "experiments.studies.learning.circle_runs"
WANTED, RATIO = 0.06, 3.0  # path error with delays [m], and that without over it
LABELS = {
    "without": "trained without delays",
    "predicted": "the same policies, predicted state",
    "delays": "trained with the identified delays",
}
COLOURS = {"without": "#9a9a9a", "predicted": "#0072B2", "delays": "#D55E00"}


def tables(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """All runs of a folder.

    Args:
        folder: Of the results.

    Returns:
        A row for each training; and one for each of its flight conditions and radii, with mean and largest error [m].
    """
    runs, errors = [], []
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        for flight in run["flights"]:
            label = _label(flight)
            for radius, values in flight["errors"].items():
                errors.append(
                    {
                        "label": label,
                        "seed": run["seed"],
                        "further_delay": flight["further_delay"],
                        "radius": float(radius),
                        "flights": len(values),
                        "path_error": float(np.mean(values)),
                        "largest": float(np.max(values)),
                    }
                )
        for method, training in run["trainings"].items():
            own = {"cost": training["cost"], "training_cpu_seconds": training["cpu_seconds"]}
            runs.append({**run, "method": method, **own})
    columns = ["method", "seed", "cost", "training_cpu_seconds", "fit_cpu_seconds", "cpu_seconds", "commit"]
    return pd.DataFrame(runs, columns=columns), pd.DataFrame(errors)


def _label(flight: dict) -> str:
    return "predicted" if flight["predicted"] else flight["method"]


def draw(errors: pd.DataFrame) -> Figure:
    """Path error over the further delay of the unit, mean of the seeds with its 95 % interval, for each radius.

    Args:
        errors: A row for each condition, seed and radius.
    """
    with house_style():
        figure, panels = plt.subplots(
            1, len(CIRCLES), figsize=(10.0, 3.4), sharey=True, layout="constrained", squeeze=False
        )
        for panel, (radius, speed) in zip(panels[0], CIRCLES, strict=True):
            for label, text in LABELS.items():
                rows = errors[(errors["label"] == label) & (errors["radius"] == radius)]
                if rows.empty:
                    continue
                delays = sorted({float(delay) for delay in rows["further_delay"]})
                times = 1e3 * np.array(delays)
                bands = np.array(
                    [
                        mean_with_band(rows.loc[rows["further_delay"] == d, "path_error"].to_numpy())
                        for d in delays
                    ]
                )
                style = {"marker": "o", "markersize": 4, "color": COLOURS[label], "label": text}
                panel.plot(times, bands[:, 0], **style)
                panel.fill_between(
                    times, bands[:, 1], bands[:, 2], color=COLOURS[label], alpha=0.2, linewidth=0
                )
            panel.axhline(WANTED, color="#555555", linestyle="--", linewidth=1)
            panel.set_yscale("log")
            panel.set_title(f"{radius:g} m at {speed:g} m/s", fontsize=9)
            panel.set_xlabel("further delay of the unit [ms]")
        panels[0, 0].set_ylabel("path error [m]")
        panels[0, -1].legend(fontsize=7)
    return figure


def draw_flights(folder: Path, seed: int) -> Figure:
    """Flights on the unit of one seed from above, one for each way.

    Args:
        folder: Of the results.
        seed: Of the unit.
    """
    radius = CIRCLES[1][0]
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    with house_style():
        figure, panels = plt.subplots(
            1, len(LABELS), figsize=(9.0, 3.2), sharex=True, sharey=True, layout="constrained"
        )
        for flight in json.loads((folder / f"unit_{seed}.json").read_text())["flights"]:
            if flight["places"] is None:
                continue
            label = _label(flight)
            panel = panels[list(LABELS).index(label)]
            x, y, _ = np.array(flight["places"]).T
            panel.plot(radius * np.cos(turn), radius * np.sin(turn), color="#40965a", linewidth=3, alpha=0.5)
            panel.plot(x, y, color=COLOURS[label], linewidth=1)
        for panel, text in zip(panels, LABELS.values(), strict=True):
            panel.set_title(text, fontsize=9)
            panel.set_aspect("equal")
            panel.set_xlabel("x [m]")
        panels[0].set_ylabel("y [m]")
    return figure


def summary(runs: pd.DataFrame, errors: pd.DataFrame) -> str:
    """Tables in Markdown: path errors by way and radius at both delays, and what the runs took.

    Args:
        runs: A row for each run.
        errors: A row for each condition, seed and radius.
    """
    radii = [radius for radius, _ in CIRCLES]
    lines = [
        "| on the unit | further delay | "
        + " | ".join(f"R = {radius:g} m" for radius in radii)
        + " | worst flight |",
        "|---|---|" + "---|" * len(radii) + "---|",
    ]
    for further in (0.0, FURTHER):
        for label, text in LABELS.items():
            rows = errors[(errors["label"] == label) & (errors["further_delay"] == further)]
            if rows.empty:
                continue
            cells = []
            for radius in radii:
                own = rows.loc[rows["radius"] == radius, "path_error"].to_numpy()
                mean, low, high = mean_with_band(own)
                cells.append(f"{mean:.3f} m [{low:.3f}, {high:.3f}]")
            lines.append(
                f"| {text} | {1e3 * further:.0f} ms | {' | '.join(cells)} | {rows['largest'].max():.3f} m |"
            )
    lines.append("")
    for method, rows in runs.groupby("method"):
        seconds = rows["training_cpu_seconds"]
        lines.append(f"{method}: {seconds.min():.0f} to {seconds.max():.0f} processor seconds a training")
    ratios = _ratios(errors)
    if len(ratios):
        reached = int((ratios >= RATIO).sum())
        lines.append(
            f"error without over error with delays at 0.5 m: {ratios.min():.1f} to {ratios.max():.1f}, "
        )
        lines[-1] += f"at least {RATIO:g} in {reached} of {len(ratios)} seeds"
    return "\n".join(lines)


def _ratios(errors: pd.DataFrame) -> np.ndarray:
    """Of each seed with both, the error without delays in the training over that with them, at the second radius."""
    own = errors[(errors["further_delay"] == FURTHER) & (errors["radius"] == CIRCLES[1][0])]
    table = own.pivot_table(index="seed", columns="label", values="path_error")
    if not {"without", "delays"} <= set(table.columns):
        return np.zeros(0)
    return (table["without"] / table["delays"]).dropna().to_numpy()


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Circles of a quadrotor, trained with and without delays.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
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
            run_once(RUNS, "unit", seed, folder, options)
            runs, errors = tables(folder)
            runs.to_csv(args.out / "runs.csv", index=False, float_format="%.3f")
            errors.to_csv(args.out / "errors.csv", index=False, float_format="%.5f")
            (args.out / "path_error.png").write_bytes(as_png(draw(errors)))
            (args.out / "flights.png").write_bytes(as_png(draw_flights(folder, args.seeds[0])))
            plt.close("all")
            print(f"seed {seed}", flush=True)
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(summary(runs, errors), as_markdown(), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

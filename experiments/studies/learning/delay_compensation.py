"""What a policy needs to see on a unit with delays: state, stack, filter or prediction (Fig. 4.8 of the thesis).

    python -m experiments.studies.learning.delay_compensation --out results/delay_compensation --seeds 0 1 2 3 4

One training after the other, each in a process of its own with one thread; a stopped study goes on where it was.
Writes a row for each seed and each way to the unit, a row for each training, and a figure.
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
from experiments.studies.learning.delay_compensation_runs import METHODS, Delays

RUNS = "experiments.studies.learning.delay_compensation_runs"
COLOURS = {
    "full_state": "#9a9a9a",
    "stacked": "#E69F00",
    "stacked_delays": "#D55E00",
    "filtered": "#56B4E9",
    "predicted": "#0072B2",
}
WANTED = 0.95  # share of the time upright that the prediction is to reach


def tables(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """All runs of a folder.

    Args:
        folder: Of the results.

    Returns:
        A row for each run, and one for each of its ways to the unit with the mean share of its episodes.
    """
    runs, shares = [], []
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        for clock, name in (("virtual", "upright"), ("wall", "upright_in_real_time")):
            for label, values in run.pop(name).items():
                if values:
                    shares.append(
                        {
                            "label": label,
                            "method": run["method"],
                            "seed": run["seed"],
                            "clock": clock,
                            "episodes": len(values),
                            "upright": float(np.mean(values)),
                        }
                    )
        runs.append(run)
    columns = ["method", "seed", "cost", "training_cpu_seconds", "cpu_seconds", "commit", "options"]
    return pd.DataFrame(runs, columns=columns), pd.DataFrame(
        shares, columns=["label", "method", "seed", "clock", "episodes", "upright"]
    )


def labels() -> dict[str, str]:
    """Every way to the unit, and the method that was trained for it."""
    return {label: name for name, method in METHODS.items() for label in method.on_unit}


def draw(shares: pd.DataFrame) -> Figure:
    """Share of the time upright on the unit, a point for each seed and the mean with its 95 % interval.

    Args:
        shares: A row for each seed and way.
    """
    virtual = shares[shares["clock"] == "virtual"]
    with house_style():
        figure, panel = plt.subplots(figsize=(8.0, 3.6), layout="constrained")
        known = [label for label in labels() if label in set(virtual["label"])]
        for place, label in enumerate(known):
            values = 100.0 * virtual.loc[virtual["label"] == label, "upright"].to_numpy()
            mean, low, high = mean_with_band(values)
            colour = COLOURS[labels()[label]]
            panel.errorbar(
                [mean], [place], xerr=[[mean - low], [high - mean]], fmt="o", color=colour, capsize=3
            )
            panel.plot(values, np.full(len(values), place + 0.22), "|", color=colour, markersize=8)
        panel.axvline(100.0 * WANTED, color="#555555", linestyle="--", linewidth=1)
        panel.set_yticks(range(len(known)), known)
        panel.invert_yaxis()
        panel.set_xlim(-3.0, 103.0)
        panel.set_xlabel("time upright on the unit [%]")
    return figure


def summary(runs: pd.DataFrame, shares: pd.DataFrame) -> str:
    """A table in Markdown: of each way to the unit the share upright, of each training cost and processor time.

    Args:
        runs: A row for each run.
        shares: A row for each seed and way.
    """
    lines = [
        "| on the unit | upright, mean of seeds [95 %] | worst seed | in real time | cost in its simulation | "
        "processor seconds of a run |",
        "|---|---|---|---|---|---|",
    ]
    for label, method in labels().items():
        rows = shares[shares["label"] == label]
        virtual, wall = (
            rows.loc[rows["clock"] == clock, "upright"].to_numpy() for clock in ("virtual", "wall")
        )
        if not len(virtual):
            continue
        mean, low, high = (100.0 * value for value in mean_with_band(virtual))
        own = runs[runs["method"] == method]
        seconds = own["cpu_seconds"]
        real = f"{100.0 * wall.mean():.1f} %" if len(wall) else "-"
        lines.append(
            f"| {label} | {mean:.1f} % [{low:.1f}, {high:.1f}] | {100.0 * virtual.min():.1f} % | {real} | "
            f"{own['cost'].mean():.0f} | {seconds.min():.0f} to {seconds.max():.0f} |"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description="Policies with and without an estimator on a unit with delays."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--sensing", type=float, default=Delays.sensing, help="mean sensing delay [s]")
    parser.add_argument("--actuation", type=float, default=Delays.actuation, help="mean actuation delay [s]")
    parser.add_argument("--episodes", type=int, default=40, help="on the unit, of each policy")
    parser.add_argument("--wall-episodes", type=int, default=0, help="further ones in real time")
    parser.add_argument("--training", type=int, default=1920, help="episodes of a training")
    args = parser.parse_args(arguments)
    options = [
        part
        for name in ("sensing", "actuation", "episodes", "wall_episodes", "training")
        for part in (f"--{name.replace('_', '-')}", f"{getattr(args, name):g}")
    ]
    folder = args.out / "runs"
    try:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        for seed in args.seeds:
            for method in args.methods:
                run_once(RUNS, method, seed, folder, options)
                runs, shares = tables(folder)
                runs.to_csv(args.out / "runs.csv", index=False, float_format="%.3f")
                shares.to_csv(args.out / "upright.csv", index=False, float_format="%.4f")
                figure = draw(shares)
                (args.out / "upright.png").write_bytes(as_png(figure))
                plt.close(figure)
                print(f"{method}, seed {seed}", flush=True)
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(summary(runs, shares), as_markdown(), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

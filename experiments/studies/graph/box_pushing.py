"""Box pushing by sampling planners whose model has the delays of the world, or none (Fig. 3.8 of the thesis).

    python -m experiments.studies.graph.box_pushing --out results/box_pushing

One method and seed after the other, each in a process of its own with one thread; a stopped study goes on where it was.
All methods meet the same starts, frictions, delays and noise. Writes a row for each episode, distances over time, the
comparison with intervals, a figure and a film.
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

from deepkoco.envs.film import film_strip, write_clip
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import writing
from deepkoco.runs.settings import ExperimentError
from deepkoco.systems.boxpush.picture import draw_box_push
from experiments.plumbing.own_process import run_once
from experiments.plumbing.provenance import as_markdown
from experiments.studies.graph.box_pushing_runs import METHODS

RUNS = "experiments.studies.graph.box_pushing_runs"
LABELS = {
    "mppi_delays": "MPPI, knows the delays",
    "mppi_without": "MPPI, knows no delay",
    "mppi_one_instant": "MPPI, knows no delay, arm as old as the box",
    "cem_delays": "CEM, knows the delays",
    "cem_without": "CEM, knows no delay",
}
PAIRS = (
    ("mppi_delays", "mppi_without"),
    ("mppi_delays", "mppi_one_instant"),
    ("cem_delays", "cem_without"),
)
COLOURS = dict(zip(LABELS, ("#1f77b4", "#d62728", "#ff7f0e", "#17becf", "#9467bd"), strict=True))
DT = 0.1  # [s]
DRAWS = 10_000  # of the bootstrap
SIZE, FPS = 260, 10


def table(folder: Path) -> tuple[pd.DataFrame, dict[str, dict[int, dict]]]:
    """Distances of all runs: a row for each method, seed, start and time; and the runs by method and seed.

    Args:
        folder: Of the runs.
    """
    runs: dict[str, dict[int, dict]] = {name: {} for name in LABELS}
    rows = []
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        runs[run["method"]][run["seed"]] = run
        distances = np.array(run["distances"])
        rows += [
            {"method": run["method"], "seed": run["seed"], "start": s, "time": DT * k, "distance": d}
            for (k, s), d in np.ndenumerate(distances)
        ]
    return pd.DataFrame(rows), {name: own for name, own in runs.items() if own}


def episodes(found: pd.DataFrame) -> pd.DataFrame:
    """A row for each episode: distance at the start and at the end, and the mean over the episode [m].

    Args:
        found: As from `table`.
    """
    grouped = found.sort_values("time").groupby(["method", "seed", "start"], sort=False)["distance"]
    return grouped.agg(first="first", final="last", mean="mean").reset_index()


def interval(values: np.ndarray, statistic=np.mean, seed: int = 0) -> tuple[float, float, float]:
    """A statistic of rows and its 95 % interval, by a bootstrap over them.

    Args:
        values: (K,) or (K, ...) rows.
        statistic: Of rows, given ``axis``.
        seed: Of the bootstrap.
    """
    drawn = np.random.default_rng(seed).integers(len(values), size=(DRAWS, len(values)))
    found = statistic(values[drawn], axis=1)
    low, high = np.quantile(found, (0.025, 0.975))
    return float(statistic(values[None], axis=1)[0]), float(low), float(high)


def closer(pairs: np.ndarray, axis: int = 0) -> np.ndarray:
    """By which share the mean of the first column is smaller than that of the second.

    Args:
        pairs: (..., K, 2).
        axis: Of K.
    """
    means = pairs.mean(axis)
    return 1.0 - means[..., 0] / means[..., 1]


def comparison(rows: pd.DataFrame) -> pd.DataFrame:
    """For each pair of methods and measure, how much closer the first one is, over the episodes that both have.

    Args:
        rows: As from `episodes`.
    """
    lines = []
    for first, second in PAIRS:
        for measure in ("final", "mean"):
            wide = rows.pivot_table(index=["seed", "start"], columns="method", values=measure)
            if not {first, second} <= set(wide.columns):
                continue
            pairs = wide[[first, second]].dropna().to_numpy()
            share, low, high = interval(pairs, closer)
            told = {"with": first, "without": second, "measure": measure, "episodes": len(pairs)}
            means = {"with_m": pairs[:, 0].mean(), "without_m": pairs[:, 1].mean()}
            lines.append({**told, **means, "closer": share, "low": low, "high": high})
    return pd.DataFrame(lines)


def draw(found: pd.DataFrame, rows: pd.DataFrame) -> Figure:
    """Mean distance over time with its interval, and the distances at the end.

    Args:
        found: As from `table`.
        rows: As from `episodes`.
    """
    with house_style():
        figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
        shown = [name for name in LABELS if name in set(rows["method"])]
        for place, name in enumerate(shown):
            own = found[found["method"] == name].pivot_table(
                index="time", columns=["seed", "start"], values="distance"
            )
            values = 100.0 * own.to_numpy()
            half = 1.96 * values.std(1, ddof=1) / np.sqrt(values.shape[1])
            time = own.index.to_numpy()
            left.plot(time, values.mean(1), color=COLOURS[name], label=LABELS[name])
            left.fill_between(
                time, values.mean(1) - half, values.mean(1) + half, color=COLOURS[name], alpha=0.15
            )
            final = 100.0 * rows.loc[rows["method"] == name, "final"].to_numpy()
            scatter = np.random.default_rng(0).uniform(-0.15, 0.15, len(final))
            right.plot(place + scatter, final, "o", ms=3, color=COLOURS[name], alpha=0.6)
            mean, low, high = interval(final)
            right.errorbar(place, mean, [[mean - low], [high - mean]], fmt="_", color="black", capsize=4)
        left.set_xlabel("time [s]")
        left.set_ylabel("distance from box to goal [cm]")
        left.set_ylim(bottom=0.0)
        left.legend(fontsize=7)
        right.set_xticks(range(len(shown)), [LABELS[name].replace(", ", ",\n") for name in shown], fontsize=7)
        right.set_ylabel("at the end [cm]")
        right.set_ylim(bottom=0.0)
    return figure


def frames(runs: dict[str, dict[int, dict]]) -> list[np.ndarray]:
    """A film of the first start of the first seed that MPPI has with and without delays, side by side.

    Args:
        runs: As from `table`.
    """
    shown = [name for name in ("mppi_delays", "mppi_without") if name in runs]
    seed = min(set.intersection(*(set(runs[name]) for name in shown)))
    films = [{k: np.array(v) for k, v in runs[name][seed]["film"].items()} for name in shown]
    pictures = [
        np.concatenate(
            [
                draw_box_push(film["angles"][k], film["box"][k], film["yaw"][k], film["goal"][k], SIZE)
                for film in films
            ],
            1,
        )
        for k in range(len(films[0]["yaw"]))
    ]
    return pictures + [pictures[-1]] * FPS


def summary(rows: pd.DataFrame, compared: pd.DataFrame, runs: dict[str, dict[int, dict]]) -> str:
    """Tables in Markdown: distances by method, comparisons, and what the runs took."""
    lines = [
        "| | episodes | at the end [cm] | median | within 3 cm | mean over the episode [cm] | processor s an episode |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in [name for name in LABELS if name in runs]:
        own = rows[rows["method"] == name]
        final, mean = (100.0 * np.asarray(own[key], float) for key in ("final", "mean"))
        seconds = sum(run["cpu_seconds"] for run in runs[name].values()) / len(own)
        end, whole = interval(final), interval(mean)
        lines.append(
            f"| {LABELS[name]} | {len(own)} | {end[0]:.1f} [{end[1]:.1f}, {end[2]:.1f}] | {np.median(final):.1f} | "
            f"{np.mean(final < 3.0):.2f} | {whole[0]:.1f} [{whole[1]:.1f}, {whole[2]:.1f}] | {seconds:.1f} |"
        )
    lines += ["", "| with delays | without | measure | closer by |", "|---|---|---|---|"]
    lines += [
        f"| {LABELS[row['with']]} | {LABELS[row['without']]} | {row['measure']} | "
        f"{row['closer']:.2f} [{row['low']:.2f}, {row['high']:.2f}] |"
        for row in compared.to_dict("records")
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Box pushing by planners with and without simulated delays.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--methods", choices=list(METHODS), nargs="+", default=list(METHODS))
    parser.add_argument("--starts", type=int, default=None, help="start states of a seed; default: as stored")
    parser.add_argument("--steps", type=int, default=None, help="of an episode; default: as stored")
    args = parser.parse_args(arguments)
    options = [] if args.starts is None else ["--starts", f"{args.starts}"]
    options += [] if args.steps is None else ["--steps", f"{args.steps}"]
    folder = args.out / "runs"
    try:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        for seed in args.seeds:
            for method in args.methods:
                run_once(RUNS, method, seed, folder, options)
                print(f"{method}, seed {seed}", flush=True)
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    found, runs = table(folder)
    rows = episodes(found)
    compared = comparison(rows)
    rows.to_csv(args.out / "episodes.csv", index=False, float_format="%.5f")
    compared.to_csv(args.out / "comparison.csv", index=False, float_format="%.5f")
    found.to_csv(args.out / "distances.csv", index=False, float_format="%.5f")
    (args.out / "distances.png").write_bytes(as_png(draw(found, rows)))
    plt.close("all")
    if "mppi_delays" in runs:
        pictures = frames(runs)
        (args.out / "film.webm").unlink(missing_ok=True)
        write_clip(args.out / "film.webm", pictures, FPS)
        with house_style():
            figure, panel = plt.subplots(figsize=(12.0, 2.2), layout="constrained")
            panel.imshow(film_strip(pictures[:-FPS], count=6))
            panel.axis("off")
        (args.out / "film.png").write_bytes(as_png(figure))
        plt.close("all")
    print(summary(rows, compared, runs), as_markdown(), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

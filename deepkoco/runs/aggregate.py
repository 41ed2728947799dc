"""`deepkoco aggregate`: learning curves and final costs of many runs."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from deepkoco.agent.references.files import read_comparison
from deepkoco.analysis.page.sweep_page import FEW, PAGE, write_sweep_page
from deepkoco.output.new_folder import new_folder
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from deepkoco.runs.train import is_finished, load_run_config

logger = logging.getLogger(__name__)

RESAMPLES = 4000
ABSENT = "not given"
CURVES = {"train/cost": "training episodes", "evaluation/cost": "noise-free episodes"}


def finished_runs(folder: Path) -> list[Path]:
    """Find the finished runs below a folder.

    Args:
        folder: Searched at any depth.

    Returns:
        Folders of the runs, sorted.

    Raises:
        ExperimentError: There is none.
    """
    found = sorted(path.parent for path in folder.rglob("metrics.csv"))
    runs = [run for run in found if is_finished(run) or _has_all_episodes(run)]
    if len(runs) < len(found):
        names = ", ".join(str(run.relative_to(folder)) for run in found if run not in runs)
        logger.warning("%s: left out what is not finished: %s", folder, names)
    if not runs:
        raise ExperimentError(f"{folder}: no finished run below it; give a folder that holds training runs")
    return runs


def _has_all_episodes(run: Path) -> bool:
    """Whether the metrics go to the end, as those of a collected run that is kept without its weights."""
    episodes = pd.read_csv(run / "metrics.csv")["episodes"].to_numpy()
    return int(episodes.max(initial=0)) >= load_run_config(run).agent.total_episodes


def conditions(configs: Mapping[Path, TrainRunConfig]) -> dict[Path, str]:
    """Name the group of runs that each run belongs to: those that differ in nothing but the seed.

    Args:
        configs: Settings of every run.

    Returns:
        Label of each run: environment, observation unless it is of states, distractors, and where groups share
        these, the settings that tell them apart.

    Raises:
        ExperimentError: Two runs of a group have the same seed.
    """
    groups: dict[str, dict[str, Any]] = {}
    member, seen = {}, {}
    for run, config in configs.items():
        settings = config.identity()
        seed = settings.pop("seed")
        key = json.dumps(settings, sort_keys=True)
        groups[key], member[run] = settings, key
        if (key, seed) in seen:
            raise ExperimentError(
                f"{run}: same settings and seed as {seen[key, seed]}; move one of them elsewhere"
            )
        seen[key, seed] = run
    plain = {key: _plain_label(settings) for key, settings in groups.items()}
    labels = {}
    for key, settings in groups.items():
        same = [groups[other] for other in groups if plain[other] == plain[key]]
        names = sorted({name for other in same for name in other})
        # Arguments of an environment may be given in one group and not in the other: that is not None.
        apart = [n for n in names if any(other.get(n, ABSENT) != settings.get(n, ABSENT) for other in same)]
        labels[key] = ", ".join([plain[key], *(f"{n} = {settings.get(n, ABSENT)}" for n in apart)])
    return {run: labels[key] for run, key in member.items()}


def _plain_label(settings: Mapping[str, Any]) -> str:
    """Agent unless it is DeepKoCo, environment, observation unless of states, and distractors of a group of runs."""
    agent = "" if settings["agent.name"] == "deepkoco" else f"{settings['agent.name']}, "
    seen = "" if settings["observation"] == "states" else f" from {settings['observation']}"
    return f"{agent}{settings['task.name']}{seen}, distractors {settings['distractors']}"


def read_runs(folder: Path) -> pd.DataFrame:
    """Read the metrics of all finished runs below a folder.

    Args:
        folder: Searched at any depth.

    Returns:
        All rows with the added columns `condition` (see `conditions`), `seed`, `run` and `not_better_than`: names of
        the references that the trained controller does not beat, "none", or "" where they were not measured.

    Raises:
        ExperimentError: There is no finished run, or two of one group have the same seed.
    """
    configs = {run: load_run_config(run) for run in finished_runs(folder)}
    labels = conditions(configs)
    frames = [
        pd.read_csv(run / "metrics.csv").assign(
            condition=labels[run], seed=config.seed, run=str(run), not_better_than=_not_better_than(run)
        )
        for run, config in configs.items()
    ]
    return pd.concat(frames, ignore_index=True)


def _not_better_than(run: Path) -> str:
    comparison = read_comparison(run)
    if comparison is None:
        return ""
    names = [reference.name for reference in comparison.references if reference.verdict != "better"]
    return ", ".join(names) or "none"


def interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Mean without the lowest and the highest quarter, rounded down to whole runs."""
    return stats.trim_mean(values, 0.25, axis=axis)


def bootstrap_interval(values: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """95 % percentile bootstrap interval of the interquartile mean over seeds; the range of fewer than `FEW`.

    The conditions are bootstrapped one by one, for their costs have no common scale.

    Args:
        values: One value per seed (n,).
        seed: Of the resampling.

    Returns:
        Lower and upper limit; NaN for a single seed.

    Source: Agarwal et al., Deep RL at the Edge of the Statistical Precipice, NeurIPS 2021.
    """
    if values.size < 2:
        return float("nan"), float("nan")
    if values.size < FEW:
        return float(values.min()), float(values.max())
    found = stats.bootstrap(
        (values,),
        interquartile_mean,
        n_resamples=RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(seed),
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def kind_of_interval(seeds: int) -> str:
    """What the two limits of `bootstrap_interval` are for a number of seeds: "none", "range" or "95 %"."""
    if seeds < 2:
        return "none"
    return "range" if seeds < FEW else "95 %"


def learning_curves(rows: pd.DataFrame) -> pd.DataFrame:
    """Average over seeds at every number of episodes.

    Args:
        rows: As given by `read_runs`.

    Returns:
        Columns condition, curve, episodes, iqm, low, high, seeds: interquartile mean and `bootstrap_interval`.
    """
    curves = []
    for (condition, episodes), group in rows.groupby(["condition", "episodes"], sort=True):  # type: ignore[reportGeneralTypeIssues]
        for curve in CURVES:
            values = group[curve].dropna().to_numpy()
            if values.size:
                low, high = bootstrap_interval(values)
                middle = float(interquartile_mean(values))
                curves.append((condition, curve, episodes, middle, low, high, values.size))
    return pd.DataFrame(curves, columns=["condition", "curve", "episodes", "iqm", "low", "high", "seeds"])


def final_table(final: pd.DataFrame) -> pd.DataFrame:
    """Noise-free cost at the end of training, one row per condition.

    Args:
        final: The last row of every run.

    Returns:
        Columns condition, n, iqm, low, high, mean, median, best, worst, interval: what low and high are, as
        `kind_of_interval` says; not_better: runs that do not beat each of their references, of those that compared.
    """
    rows = []
    for condition, group in final.groupby("condition", sort=True):
        costs = group["evaluation/cost"].to_numpy()
        low, high = bootstrap_interval(costs)
        middle = float(interquartile_mean(costs))
        spread = (costs.mean(), np.median(costs), costs.min(), costs.max())
        compared = group.loc[group["not_better_than"] != "", "not_better_than"]
        count = f"{(compared != 'none').sum()} of {len(compared)}" if len(compared) else "-"
        rows.append((condition, costs.size, middle, low, high, *spread, kind_of_interval(costs.size), count))
    names = [
        "condition",
        "n",
        "iqm",
        "low",
        "high",
        "mean",
        "median",
        "best",
        "worst",
        "interval",
        "not_better",
    ]
    return pd.DataFrame(rows, columns=names)  # pyright: ignore[reportArgumentType]


def draw(curves: pd.DataFrame, path: Path) -> None:
    """Draw the curves, one panel per kind of episode and one colour per condition.

    Args:
        curves: As given by `learning_curves`.
        path: PNG to write.
    """
    figure = Figure(figsize=(9, 3.5), layout="constrained")
    axes = figure.subplots(1, len(CURVES), sharey=True)
    for axis, (curve, title) in zip(axes, CURVES.items(), strict=True):
        chosen = curves[curves["curve"] == curve]
        for i, (condition, group) in enumerate(chosen.groupby("condition", sort=True)):
            seeds = int(np.max(group["seeds"]))
            band = f", band: {kind_of_interval(seeds)}" if seeds > 1 else ""
            axis.plot(
                group["episodes"], group["iqm"], color=f"C{i}", label=f"{condition} (n = {seeds}{band})"
            )
            axis.fill_between(
                group["episodes"], group["low"], group["high"], color=f"C{i}", alpha=0.2, linewidth=0
            )
        axis.set(title=title, xlabel="training episodes", ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("cost per episode (iqm over seeds)")
    axes[-1].legend(fontsize=8)
    figure.savefig(path, dpi=150)


def aggregate(runs: Path, out: Path) -> pd.DataFrame:
    """Write `curves.csv`, `final.csv`, `table.csv`, `learning_curve.png`, and `index.html`, which shows them.

    Args:
        runs: Folder that holds runs, at any depth.
        out: Folder to make, all or nothing.

    Returns:
        What `final_table` gives.

    Raises:
        ExperimentError: The new folder exists, or see `read_runs`.
    """
    if out.exists():
        raise ExperimentError(f"{out}: exists already; choose another --out")
    with new_folder(out) as partial:
        final = write_aggregate(runs, partial)
        curves, table = pd.read_csv(partial / "curves.csv"), final_table(final)
        write_sweep_page(partial, curves, final, table, runs.resolve().name, out)
    return table


def write_aggregate(runs: Path, out: Path) -> pd.DataFrame:
    """Write the files of `aggregate` into a new folder.

    Args:
        runs: Folder that holds runs, at any depth.
        out: Folder to make.

    Returns:
        The last row of every run.

    Raises:
        ExperimentError: See `read_runs`; the folder is not made then.
    """
    rows = read_runs(runs)
    curves = learning_curves(rows)
    final = rows.sort_values("episodes").groupby("run").tail(1).sort_values(["condition", "seed"])
    kept = ["episodes", "updates", "evaluation/cost", "evaluation/cost_sd", "evaluation/cost_median"]
    out.mkdir(parents=True, exist_ok=True)
    curves.to_csv(out / "curves.csv", index=False, float_format="%.6g")
    final[["condition", "seed", *kept, "evaluation/episodes", "not_better_than", "seconds"]].to_csv(
        out / "final.csv", index=False, float_format="%.6g"
    )
    final_table(final).to_csv(out / "table.csv", index=False, float_format="%.6g")
    draw(curves, out / "learning_curve.png")
    return final


def summarise(runs: Path, out: Path | None) -> str:
    """`aggregate`, and what a terminal shows of it.

    Args:
        runs: Folder that holds runs, at any depth.
        out: Folder to make; None takes RUNS_summary beside them.

    Returns:
        The table as text, what its interval is, and where the files are.

    Raises:
        ExperimentError: See `aggregate`.
    """
    out = out or runs.with_name(f"{runs.resolve().name}_summary")
    table = aggregate(runs, out)
    lines = [
        table.to_string(index=False, float_format="%.1f"),
        "Cost of noise-free episodes; iqm is the interquartile mean over seeds.",
    ]
    if set(table["not_better"]) != {"-"}:
        lines.append("not_better: runs that do not beat zero action, random episodes and EDMDc + planner.")
    kinds = {kind_of_interval(n) for n in table["n"].tolist()}
    if "95 %" in kinds:
        lines.append("interval 95 %: low and high are the 95 % bootstrap interval of iqm.")
    if "range" in kinds:
        lines.append(
            "interval range: low and high are the lowest and the highest cost; "
            f"an interval takes {FEW} seeds or more."
        )
    return "\n".join([*lines, f"Written to {out}; {out / PAGE} shows it"])

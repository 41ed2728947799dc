"""Scores of a suite's runs: one row per seed, their interquartile means, and their mean over all tasks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.agent.references.comparison import EDMDC, RANDOM, ZERO
from deepkoco.agent.references.files import read_comparison
from deepkoco.analysis.page.sweep_page import FEW
from deepkoco.runs.aggregate import RESAMPLES, bootstrap_interval, interquartile_mean
from deepkoco.runs.settings import ExperimentError
from deepkoco.runs.train import CONFIG_FILE
from experiments.benchmark.suite import FULL_SCORE, Cell, ScoreRange, Suite, cells
from experiments.studies.learning.comparison.runs import COST, METRICS_FILE, evaluations, groups, read_run

ALONE = "none"
METHOD = ["task", "among", "agent"]
REFERENCES = {"zero_action": ZERO, "random": RANDOM, "edmdc": EDMDC}


def score(costs: np.ndarray | float, span: ScoreRange) -> np.ndarray | float:
    """From costs of an episode to scores: 0 at ``zero_cost``, 1000 at ``full_cost``, on a line through both."""
    return FULL_SCORE * (span.zero_cost - costs) / (span.zero_cost - span.full_cost)


def read_evaluations(suite: Suite, out: Path) -> pd.DataFrame:
    """All evaluations of all runs that have evaluated, finished or not.

    Args:
        suite: Of the runs.
        out: Folder of the benchmark.

    Returns:
        As `comparison.runs.evaluations` gives them, with the suite's names of agents and distractors.

    Raises:
        ExperimentError: No run has evaluated yet, or one cannot be read.
    """
    frames = []
    for cell in cells(suite):
        folder = cell.folder(out)
        if not all((folder / name).is_file() for name in (METRICS_FILE, CONFIG_FILE)):
            continue
        run = read_run(folder, folder.relative_to(out).as_posix())
        if run.rows[COST].notna().to_numpy().any():
            frames.append(
                evaluations([run]).assign(agent=cell.agent, distractors=cell.among, among=cell.among)
            )
    if not frames:
        raise ExperimentError(f"{out}: no run has evaluated yet")
    return pd.concat(frames, ignore_index=True)


def seed_scores(table: pd.DataFrame, suite: Suite, out: Path) -> pd.DataFrame:
    """The last evaluation of every run.

    Args:
        table: As given by `read_evaluations`.
        suite: Of the runs.
        out: Folder of the benchmark.

    Returns:
        One row per run: task, among, agent, seed, finished, score, cost, the noise-free episodes behind it, the costs
        of zero action, random episodes and EDMDc, and how much training it was.
    """
    rows = []
    for names, own in groups(table, [*METHOD, "seed"]):
        last = own.sort_values("steps").to_dict("records")[-1]
        folder = Cell(names["agent"], names["task"], names["among"], int(names["seed"])).folder(out)
        comparison = read_comparison(folder)
        measured = {} if comparison is None else {r.name: r.cost.mean for r in comparison.references}
        rows.append(
            {
                **names,
                "finished": last["finished"],
                "score": score(float(last[COST]), suite.tasks[names["task"]]),
                "cost": last[COST],
                "evaluation_episodes": last["evaluation/episodes"],
                **{name: measured.get(known, float("nan")) for name, known in REFERENCES.items()},
                **{
                    name: last[name]
                    for name in ("episodes", "steps", "updates", "seconds", "processor_seconds")
                },
            }
        )
    return pd.DataFrame(rows)


def method_scores(seeds: pd.DataFrame) -> pd.DataFrame:
    """Interquartile means over seeds.

    Args:
        seeds: As given by `seed_scores`.

    Returns:
        One row per task, distractors and agent: n, unfinished, score with low and high, whether these are a 95 %
        bootstrap interval or the range of fewer than five seeds, loss against the task alone [%] where all runs of both
        are finished, cost, and the least steps and updates and the mean processor seconds of a seed.
    """
    rows = []
    for names, own in groups(seeds, METHOD):
        values = own["score"].to_numpy(float)
        low, high = bootstrap_interval(values)
        rows.append(
            {
                **names,
                "n": len(own),
                "unfinished": int((~own["finished"].to_numpy(bool)).sum()),
                "score": float(interquartile_mean(values)),
                "low": low,
                "high": high,
                "interval": "range" if len(own) < FEW else "95 %",
                "loss": float("nan"),
                "cost": float(interquartile_mean(own["cost"].to_numpy(float))),
                "steps": int(own["steps"].to_numpy().min()),
                "updates": int(own["updates"].to_numpy().min()),
                "processor_seconds": float(own["processor_seconds"].to_numpy(float).mean()),
            }
        )
    done = [row for row in rows if not row["unfinished"]]  # others have had less training
    alone = {(row["task"], row["agent"]): row["score"] for row in done if row["among"] == ALONE}
    for row in done:
        own = alone.get((row["task"], row["agent"]), float("nan"))
        # Where nothing is learned alone, there is nothing to lose.
        row["loss"] = (
            100.0 * (1.0 - row["score"] / own) if row["among"] != ALONE and own > 0.0 else float("nan")
        )
    return pd.DataFrame(rows)


def overall_scores(seeds: pd.DataFrame, seed: int = 0) -> pd.DataFrame:
    """Interquartile means over all tasks and seeds together, for agents that have every task.

    Args:
        seeds: As given by `seed_scores`.
        seed: Of the resampling.

    Returns:
        One row per distractors and agent: tasks, runs, score, and its 95 % bootstrap interval over seeds, which are
        resampled within each task.

    Source: Agarwal et al. 2021 (stratified bootstrap).
    """
    rows, count = [], len(set(seeds["task"]))
    generator = np.random.default_rng(seed)
    for names, own in groups(seeds, ["among", "agent"]):
        strata = [part["score"].to_numpy(float) for _, part in groups(own, ["task"])]
        if len(strata) < count:
            continue
        drawn = [s[generator.integers(s.size, size=(RESAMPLES, s.size))] for s in strata]
        low, high = np.percentile(interquartile_mean(np.concatenate(drawn, 1), axis=1), [2.5, 97.5])
        mean = float(interquartile_mean(np.concatenate(strata)))
        rows.append({**names, "tasks": count, "runs": len(own), "score": mean, "low": low, "high": high})
    return pd.DataFrame(rows, columns=["among", "agent", "tasks", "runs", "score", "low", "high"])


def order_of(suite: Suite) -> dict[str, Sequence[str]]:
    """In which order tables name tasks, distractors and agents: that of the suite."""
    return {"task": list(suite.tasks), "among": list(suite.among), "agent": list(suite.agents)}

"""The tables of `experiments.tuning`: all trials, and the settings that are chosen from them."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import OmegaConf

from deepkoco.output.whole_file import write_whole_text
from experiments.provenance import as_markdown


def trial_table(points: Sequence[dict[str, Any]], runs: pd.DataFrame, runs_per_trial: int) -> pd.DataFrame:
    """One row per trial whose runs are all done, the best first.

    Args:
        points: Settings of every trial by name.
        runs: As given by `tuning.read_runs`.
        runs_per_trial: How many a whole trial has.

    Returns:
        Columns trial, score (mean cost of the runs), one per condition with the mean over its seeds, the settings,
        steps, updates and seconds of all runs together, and error. Settings that a trial leaves alone are empty.
    """
    names = list(dict.fromkeys(name for point in points for name in point))
    rows = []
    for number, own in runs.groupby("trial", sort=True):
        if len(own) < runs_per_trial:
            continue
        point = points[int(number)]  # pyright: ignore[reportArgumentType]
        costs = own["cost"].to_numpy(float)
        conditions = {
            f"cost/{d}": float(g["cost"].to_numpy(float).mean()) for d, g in own.groupby("distractors")
        }
        sums = {name: float(np.nansum(own[name].to_numpy(float))) for name in ("steps", "updates", "seconds")}
        errors = sorted({str(error) for error in own["error"] if error})
        settings = {name: point.get(name) for name in names}
        score = {"trial": number, "score": float(costs.mean()), **conditions}
        rows.append({**score, **settings, **sums, "error": "; ".join(errors)})
    table = pd.DataFrame(rows)
    return table.sort_values(["score", "trial"], ignore_index=True) if rows else table


def chosen_yaml(agent: str, point: dict[str, Any], where: str) -> str:
    """The settings of a trial as a file of configs/agent_on_task.

    Args:
        agent: Its name.
        point: Dotted name to value.
        where: What the comment says of their origin.
    """
    config = OmegaConf.create({"agent": {}})
    for name, value in point.items():
        OmegaConf.update(config, f"agent.{name}", value)
    text = OmegaConf.to_yaml(config) if point else ""
    return f"# @package _global_\n# {agent}: {where}\n{text}"


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def page(agent: str, table: pd.DataFrame, runs: pd.DataFrame, planned: int, command: str) -> str:
    """What was tried, what came of it and what is chosen.

    Args:
        agent: Its name.
        table: As given by `trial_table`, not empty.
        runs: As given by `tuning.read_runs`.
        planned: Runs of the whole budget.
        command: That made it.
    """
    best, (steps, seconds) = table.iloc[0], (runs[name].sum() for name in ("steps", "seconds"))
    scores = dict(zip(table["trial"].tolist(), table["score"].tolist(), strict=True))
    against = f" The agent as it is (trial 0) has {scores[0]:.1f}." if 0 in scores else ""
    shown = table if table["error"].to_numpy(bool).any() else table.drop(columns="error")
    lines = [f"| {' | '.join(shown.columns)} |", "|" + "---|" * len(shown.columns)]
    lines += [
        f"| {' | '.join(_cell(value) for value in row)} |" for row in shown.itertuples(index=False, name=None)
    ]
    unfinished = (
        "" if len(runs) == planned else f"\n**Not finished:** {len(runs)} of {planned} runs are done.\n"
    )
    return f"""# Tuning of {agent}

```
{command}
```
{unfinished}
Score: mean noise-free cost at the end of a trial's runs. Chosen is the trial with the lowest one, number
{best["trial"]} with {best["score"]:.1f}.{against} The lowest of several noisy scores is a little too low;
what counts is the cost of other seeds with these settings.

{len(runs)} runs, {steps:,.0f} environment steps, {seconds / 60:.0f} minutes in all.

{chr(10).join(lines)}
"""


def write_report(
    folder: Path,
    agent: str,
    points: Sequence[dict[str, Any]],
    runs: pd.DataFrame,
    planned: int,
    space: Path,
    command: str,
) -> None:
    """Write all files of a tuning anew, each whole.

    Args:
        folder: Made if it is not there.
        agent: Its name.
        points: Settings of every trial.
        runs: As given by `tuning.read_runs`.
        planned: Runs of the whole budget.
        space: File of the search space.
        command: That made it.
    """
    table = trial_table(points, runs, planned // len(points))
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(space, folder / "space.yaml")
    _write(folder / "runs.csv", runs.to_csv(index=False, float_format="%.6g"))
    if table.empty:
        return
    number = int(table["trial"].iloc[0])
    where = f"trial {number} of {len(points)} of experiments.tuning, mean cost {table['score'].iloc[0]:.1f}"
    _write(folder / "trials.csv", table.to_csv(index=False, float_format="%.6g"))
    _write(folder / "chosen.yaml", chosen_yaml(agent, points[number], where))
    _write(folder / "README.md", page(agent, table, runs, planned, command))
    _write(folder / "PROVENANCE.md", as_markdown() + "\n")


def _write(path: Path, text: str) -> None:
    write_whole_text(path, text)

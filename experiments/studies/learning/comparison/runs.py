"""Runs of several agents as one table of evaluations."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deepkoco.runs.aggregate import ABSENT
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from deepkoco.runs.train import CONFIG_FILE, is_finished, load_run_config

logger = logging.getLogger(__name__)

AXES = {
    "episodes": "training episodes",
    "steps": "environment steps",
    "updates": "updates",
    "seconds": "wall-clock time [s]",
    "processor_seconds": "processor time [s]",
}
YOUNGER = ("processor_seconds",)
"""Axes that runs of earlier releases did not measure: NaN there."""
METRICS_FILE = "metrics.csv"
PANEL = ["task", "observation", "distractors"]
METHOD = ["agent", "variant"]
COST = "evaluation/cost"
KEPT = [*AXES, "train/cost", COST, "evaluation/cost_sd", "evaluation/episodes"]
OF_A_RUN = [*PANEL, *METHOD, "seed"]


@dataclass(frozen=True)
class ComparedRun:
    """One run of the comparison.

    Attributes:
        folder: Of the run, or of its metrics and settings alone.
        name: The folder as the results name it: without what lies above the working directory or the given folder.
        config: Its settings.
        rows: Its metrics.
        finished: Whether it came to its end.
    """

    folder: Path
    name: str
    config: TrainRunConfig
    rows: pd.DataFrame
    finished: bool

    @property
    def panel(self) -> tuple[str, str, str]:
        """Task, observation and distractors."""
        return self.config.task.name, self.config.observation, self.config.distractors


def find_runs(folders: Sequence[Path], unfinished: bool) -> list[ComparedRun]:
    """Read all runs below some folders.

    Args:
        folders: Searched at any depth; runs of training, and those collected without their weights.
        unfinished: Whether runs that have not come to their end count too.

    Returns:
        The runs, sorted by folder; each once, though the folders may overlap.

    Raises:
        ExperimentError: A folder holds no run, metrics miss a column, or there is no run left.
    """
    found: dict[Path, ComparedRun] = {}
    left_out = 0
    for folder in folders:
        paths = sorted(
            path.parent for path in folder.rglob(METRICS_FILE) if (path.parent / CONFIG_FILE).is_file()
        )
        if not paths:
            raise ExperimentError(f"{folder}: no run below it; give folders that hold training runs")
        for path in paths:
            run = read_run(path, _name(path, folder))
            if run.finished or unfinished:
                found.setdefault(path.resolve(), run)
            else:
                left_out += 1
    if left_out:
        logger.warning("left out %d runs that are not finished; --unfinished draws them too", left_out)
    if not found:
        names = ", ".join(map(str, folders))
        raise ExperimentError(f"{names}: no finished run below it; --unfinished takes the others too")
    return list(found.values())


def _name(run: Path, given: Path) -> str:
    here = Path.cwd()
    if run.resolve().is_relative_to(here):
        return run.resolve().relative_to(here).as_posix()
    return (Path(given.resolve().name) / run.relative_to(given)).as_posix()


def read_run(folder: Path, name: str) -> ComparedRun:
    """Read one run.

    Args:
        folder: Of the run.
        name: As the results are to name it.

    Raises:
        ExperimentError: Its settings or metrics cannot be read.
    """
    config = load_run_config(folder)
    try:
        rows = pd.read_csv(folder / METRICS_FILE)
    except (OSError, ValueError) as error:
        raise ExperimentError(f"{folder / METRICS_FILE}: {' '.join(str(error).split())}") from error
    rows = rows.assign(**{name: np.nan for name in YOUNGER if name not in rows})
    if missing := [name for name in KEPT if name not in rows]:
        raise ExperimentError(
            f"{folder / METRICS_FILE}: no column {', '.join(missing)}; not the metrics of a run"
        )
    done = int(rows["episodes"].to_numpy().max(initial=0)) >= config.agent.total_episodes
    return ComparedRun(folder, name, config, rows, is_finished(folder) or done)


def variants(runs: Sequence[ComparedRun]) -> list[str]:
    """What sets the settings of runs of one agent apart within a panel.

    Args:
        runs: Of any panels and agents.

    Returns:
        For each run the settings that not all of its agent in its panel share, such as "agent.variant = paper"; ""
        where all are the same but for the seed.

    Raises:
        ExperimentError: Two runs have the same settings and seed.
    """
    settings = [run.config.identity() for run in runs]
    seeds = [own.pop("seed") for own in settings]
    seen: dict[str, Path] = {}
    groups: dict[tuple, list[int]] = {}
    for i, (run, own, seed) in enumerate(zip(runs, settings, seeds, strict=True)):
        key = json.dumps([own, seed], sort_keys=True)
        if key in seen:
            raise ExperimentError(
                f"{run.folder}: same settings and seed as {seen[key]}; leave one of them out"
            )
        seen[key] = run.folder
        groups.setdefault((*run.panel, run.config.agent.name), []).append(i)
    labels = [""] * len(runs)
    for members in groups.values():
        names = _differing([settings[i] for i in members])
        for i in members:
            labels[i] = ", ".join(f"{name} = {settings[i].get(name, ABSENT)}" for name in names)
    return labels


def _differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    names = sorted({name for own in settings for name in own})
    return [n for n in names if any(own.get(n, ABSENT) != settings[0].get(n, ABSENT) for own in settings)]


def groups(table: pd.DataFrame, names: Sequence[str]) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Parts of a table that share the values of some columns, in their order.

    Args:
        table: Any.
        names: Of the columns.

    Yields:
        The values by name, and the rows.
    """
    for key, rows in table.groupby(list(names), sort=True):
        yield dict(zip(names, key, strict=True)), rows  # pyright: ignore[reportArgumentType, reportCallIssue]


def evaluations(runs: Sequence[ComparedRun]) -> pd.DataFrame:
    """All evaluations of all runs, as they were measured.

    Args:
        runs: At least one.

    Returns:
        One row per evaluation: task, observation, distractors, agent, variant, seed, `KEPT`, finished, last (whether
        it is the one at the end of a finished run) and run.

    Raises:
        ExperimentError: Two runs have the same settings and seed, or none has evaluated yet.
    """
    frames = []
    for run, variant in zip(runs, variants(runs), strict=True):
        rows = run.rows[KEPT]
        rows = rows.assign(last=run.finished & (rows["episodes"] == rows["episodes"].max()))
        rows = rows[rows[COST].notna()]
        task, observation, distractors = run.panel
        frames.append(
            rows.assign(
                task=task,
                observation=observation,
                distractors=distractors,
                agent=run.config.agent.name,
                variant=variant,
                seed=run.config.seed,
                finished=run.finished,
                run=run.name,
            )
        )
    table = pd.concat(frames, ignore_index=True).loc[:, [*OF_A_RUN, *KEPT, "finished", "last", "run"]]
    if table.empty:
        raise ExperimentError(
            "no run has evaluated yet; agent.evaluation_episodes=10 evaluates during training"
        )
    return table


def settings_table(runs: Sequence[ComparedRun]) -> pd.DataFrame:
    """Every hyper-parameter of every method.

    Args:
        runs: At least one.

    Returns:
        Columns task, observation, distractors, agent, variant, setting and value.
    """
    rows = {
        (*run.panel, run.config.agent.name, variant, name): str(value)
        for run, variant in zip(runs, variants(runs), strict=True)
        for name, value in run.config.identity().items()
        if name.startswith("agent.") and name != "agent.name"
    }
    columns = [*PANEL, *METHOD, "setting", "value"]
    return pd.DataFrame([(*key, value) for key, value in sorted(rows.items())], columns=columns)

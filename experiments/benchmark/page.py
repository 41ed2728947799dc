"""Writes the table, the curves and the page of a suite."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from deepkoco.output.whole_file import write_whole_text
from experiments.benchmark.scores import (
    METHOD,
    method_scores,
    order_of,
    overall_scores,
    read_evaluations,
    seed_scores,
)
from experiments.benchmark.suite import Suite
from experiments.plumbing.provenance import as_markdown
from experiments.studies.learning.comparison.curves import learning_curves
from experiments.studies.learning.comparison.drawing import draw, method_label

AXES = ("steps", "updates", "processor_seconds")


def write_results(suite: Suite, out: Path, command: str) -> pd.DataFrame:
    """Write scores, tables, curves and the page anew from the runs that are there.

    Args:
        suite: Of the runs.
        out: Folder of the benchmark.
        command: That the page names.

    Returns:
        The scores of the methods.

    Raises:
        ExperimentError: No run has evaluated yet, or one cannot be read.
    """
    table = read_evaluations(suite, out)
    seeds = _sorted(seed_scores(table, suite, out), suite)
    methods, overall = _sorted(method_scores(seeds), suite), _sorted(overall_scores(seeds), suite)
    curves = learning_curves(table)
    for name, content in (("scores", seeds), ("table", methods), ("overall", overall), ("curves", curves)):
        text = content.to_csv(index=False, float_format="%.6g", lineterminator="\n")
        write_whole_text(out / f"{name}.csv", text)
    draw(curves, dict.fromkeys(suite.tasks), out / "curves.png", AXES)
    write_whole_text(out / "PROVENANCE.md", as_markdown() + "\n")
    write_whole_text(out / "index.md", page(suite, seeds, methods, overall, command))
    return methods


def _sorted(table: pd.DataFrame, suite: Suite) -> pd.DataFrame:
    order = order_of(suite)
    names = [name for name in (*METHOD, "seed") if name in table]
    return table.sort_values(
        names,
        key=lambda c: c.map(list(order[str(c.name)]).index) if c.name in order else c,
        ignore_index=True,
    )


def _table(rows: pd.DataFrame, columns: dict[str, str]) -> str:
    lines = [f"| {' | '.join(columns.values())} |", f"|{'---|' * len(columns)}"]
    lines += [
        f"| {' | '.join(_cell(name, row[name]) for name in columns)} |" for row in rows.to_dict("records")
    ]
    return "\n".join(lines)


def _cell(name: str, value: object) -> str:
    if name == "agent":
        return method_label(str(value), "")
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)


def page(
    suite: Suite, seeds: pd.DataFrame, methods: pd.DataFrame, overall: pd.DataFrame, command: str
) -> str:
    """The page of a suite.

    Args:
        suite: Of the runs.
        seeds: As given by `scores.seed_scores`.
        methods: As given by `scores.method_scores`.
        overall: As given by `scores.overall_scores`.
        command: That made it.

    Returns:
        Markdown.
    """
    planned = len(suite.tasks) * len(suite.among) * len(suite.agents) * len(suite.seeds)
    finished = int(seeds["finished"].to_numpy(bool).sum())
    spans = "; ".join(f"{t} {s.zero_cost:g} and {s.full_cost:g}" for t, s in suite.tasks.items())
    begun = (
        f"; {len(seeds) - finished} more count with their last evaluation" if len(seeds) > finished else ""
    )
    parts = [
        f"# Benchmark {suite.name}",
        f"```\n{command}\n```",
        f"{finished} of {planned} runs are finished{begun}.",
        "![learning curves](curves.png)",
        "Lines: interquartile mean over seeds at equal environment steps; bands: 95 % percentile bootstrap over "
        "seeds, of fewer than 5 seeds their range. Updates and processor seconds are medians over seeds of what they "
        "had after so many steps.",
        f"A score is 0 and 1000 at these costs of an episode: {spans}. Loss: how much of the score that the agent has "
        "on the task alone is gone among the distractors.",
        _table(methods.assign(limits=[_limits(row) for row in methods.to_dict("records")]), METHOD_COLUMNS),
    ]
    if len(suite.tasks) > 1 and not overall.empty:
        columns = {
            "among": "among",
            "agent": "agent",
            "tasks": "tasks",
            "runs": "runs",
            "score": "score, iqm",
        }
        limits = overall.assign(limits=[_limits(row) for row in overall.to_dict("records")])
        parts += ["## All tasks together", _table(limits, {**columns, "limits": "95 %"})]
    parts += ["## Every seed", _table(seeds, SEED_COLUMNS)]
    parts.append(
        "`scores.csv` holds the seeds, `table.csv` and `overall.csv` the means, `curves.csv` what the figure draws, "
        "`PROVENANCE.md` commit, versions and processor of the last call."
    )
    return "\n\n".join(parts) + "\n"


METHOD_COLUMNS = {
    "task": "task", "among": "among", "agent": "agent", "n": "seeds", "unfinished": "unfinished", "score": "score, iqm",
    "limits": "interval or range", "loss": "loss [%]", "cost": "cost", "steps": "steps", "updates": "updates",
    "processor_seconds": "processor [s]",
}  # fmt: skip
SEED_COLUMNS = {
    "task": "task", "among": "among", "agent": "agent", "seed": "seed", "finished": "finished", "score": "score",
    "cost": "cost", "zero_action": "zero action", "random": "random episodes", "edmdc": "EDMDc + planner",
    "steps": "steps", "updates": "updates", "processor_seconds": "processor [s]",
}  # fmt: skip


def _limits(row: Mapping) -> str:
    if math.isnan(row["low"]):
        return ""
    kind = f" ({row['interval']})" if "interval" in row else ""
    return f"{row['low']:.0f} to {row['high']:.0f}{kind}"

"""Tables and figure of the study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from deepkoco.output.picture import house_style
from deepkoco.output.whole_file import whole_file
from experiments.plumbing.provenance import as_markdown

RESAMPLES = 2000
COLOURS = {
    "observation, both": "C0",
    "observation, time stamps": "C1",
    "latent, both": "C2",
    "latent, time stamps": "C3",
    "no compensation": "C4",
    "undelayed from the first arrival": "0.3",
}
"""Colour of each method that is drawn, the same in both panels."""


def write_report(rows: Sequence[Mapping[str, Any]], out: Path) -> None:
    """Write table.csv, the figure with its data and PROVENANCE.md.

    Args:
        rows: Of costs.jsonl.
        out: Folder.
    """
    frame = pd.DataFrame(
        [
            {**{k: row[k] for k in ("task", "seed", "kind", "law", "method")}, "episode": i, "cost": cost}
            for row in rows
            for i, cost in enumerate(row["costs"])
        ]
    )
    table = summary(frame)
    with whole_file(out / "table.csv") as partial:
        table.to_csv(partial, index=False, float_format="%.5g")
    draw(table, out)
    commits = ", ".join(sorted({str(row["commit"]) for row in rows}))
    (out / "PROVENANCE.md").write_text(
        f"Rows are of commits {commits}.\n\n{as_markdown()}\n", encoding="utf-8"
    )


def summary(frame: pd.DataFrame) -> pd.DataFrame:
    """Mean cost, and performance: 1 is the policy without delays, 0 random actions, both from the same start states.

    Intervals are bootstraps over start states: of each, all seeds and both references are drawn together.
    """
    costs: dict[tuple[str, str, str], dict[tuple[int, int], float]] = {}
    kinds: dict[str, str] = {}
    for row in frame.to_dict("records"):
        of = costs.setdefault((row["task"], row["law"], row["method"]), {})
        of[row["seed"], row["episode"]] = row["cost"]
        kinds[row["law"]] = row["kind"]
    rows = []
    for (task, law, method), own in costs.items():
        starts = sorted(own)
        values, best, worst = (
            np.array([of[start] for start in starts])
            for of in (own, costs[task, "0+0", "no compensation"], costs[task, "0+0", "random"])
        )
        draws = np.random.default_rng(0).integers(len(starts), size=(RESAMPLES, len(starts)))
        means = [sample[draws].mean(1) for sample in (values, best, worst)]
        low, high = np.quantile((means[2] - means[0]) / (means[2] - means[1]), (0.025, 0.975))
        rows.append(
            {
                "task": task,
                "kind": kinds[law],
                "law": law,
                "method": method,
                "seeds": len({seed for seed, _ in starts}),
                "episodes": len(starts),
                "cost": values.mean(),
                "cost_ratio": values.mean() / best.mean(),
                "performance": (worst.mean() - values.mean()) / (worst.mean() - best.mean()),
                "performance_low": low,
                "performance_high": high,
            }
        )
    return pd.DataFrame(rows)


def draw(table: pd.DataFrame, out: Path) -> None:
    """Performance over the constant delay, both sides alike; delays.csv beside delays.png."""
    records = [
        {**row, "steps": 2.0 * float(row["law"].split("+")[0])}
        for row in table.to_dict("records")
        if row["kind"] == "constant" and row["method"] in COLOURS and len(set(row["law"].split("+"))) == 1
    ]
    constant = pd.DataFrame(records).sort_values("steps")
    with house_style():
        tasks = list(dict.fromkeys(constant.task))
        figure, axes = plt.subplots(1, len(tasks), figsize=(4.2 * len(tasks), 3.2), squeeze=False)
        for axis, task in zip(axes[0], tasks, strict=True):
            for method, own in constant[constant.task == task].groupby("method", sort=False):
                colour = COLOURS[str(method)]
                axis.plot(own.steps, own.performance, marker="o", label=str(method), color=colour)
                axis.fill_between(
                    own.steps, own.performance_low, own.performance_high, color=colour, alpha=0.2
                )
            axis.axhline(0.95, color="0.6", linewidth=0.8, linestyle=":")
            axis.set(
                title=str(task).replace("_", "-"), xlabel="delay of observation and command together [steps]"
            )
        axes[0][0].set_ylabel("performance (1: no delays, 0: random)")
        for axis in axes[0]:
            axis.legend(fontsize="small")
        figure.savefig(out / "delays.png")
        plt.close(figure)
    with whole_file(out / "delays.csv") as partial:
        constant.to_csv(partial, index=False, float_format="%.5g")

"""Tables and figure of the study, from whatever episodes there are."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.ticker import FuncFormatter

from deepkoco.agent.config import TrainingConfig
from deepkoco.output.whole_file import whole_file
from experiments.ablation_differences import paired_interval
from experiments.closing_the_loop.hidden import Case
from experiments.closing_the_loop.steps import ARMS, SELECTION_EPISODES
from experiments.provenance import as_markdown

COLOURS = {"baseline": "#9a9a9a", "refit": "#3b7dd8", "extended": "#e4572e", "unit": "#222222"}
EPISODE = 10.0  # length of an episode [s]
READING = "## What it says"
"""Heading in README.md from which on the text is written by hand and kept."""
METHOD = """# What naming a hidden effect is worth in control

```
python -m experiments.closing_the_loop --seeds 0 1 2 --json
```

An effect is hidden in a rod pendulum's unit (own integrator, true sticking, sensor noise). 30 s of torque steps
are recorded and diagnosed. DeepKoCo is trained with {training} episodes in the simulator as given, in the one
whose own parameters were refitted to the log, in the one extended with what was named, and on the unit itself
in virtual time: what knowing the unit would give this agent, at {minutes:.0f} minutes of a robot's time and
{selection:.0f} more to choose among its weights. All see the sensor's noise and the last three actions; kept are
the weights with the lowest noise-free cost over 30 episodes where they were trained. Each policy then runs on
the unit from the same start states; differences are paired by seed and start state, intervals are a bootstrap
over both. A cell holds the mean cost of an episode [95 % interval] and the share that stands at the end.

"""
LABELS = {
    "baseline": "in the simulator as given",
    "refit": "in the simulator refitted",
    "extended": "in the extended simulator",
    "unit": "on the unit itself",
}


def summarise(episodes: Any) -> Any:
    """Mean costs with intervals, and what each arm saves against the simulator as given.

    Args:
        episodes: Columns case, arm, seed, clock, episode, cost, upright, overruns.

    Returns:
        One row per case, clock and arm: seeds, episodes, cost, low, high (95 %, bootstrap over seeds and episodes),
        upright, overruns, and saved, saved_low, saved_high over the seeds and start states that both have.
    """
    rows = []
    for (case, clock), group in episodes.groupby(["case", "clock"], sort=False):
        costs = {arm: _by_seed(group[group["arm"] == arm]) for arm in ARMS}
        for arm in ARMS:
            own = group[group["arm"] == arm]
            if own.empty:
                continue
            low, high = paired_interval(list(costs[arm].values()))
            row: dict[str, Any] = {
                "case": case,
                "clock": clock,
                "arm": arm,
                "seeds": len(costs[arm]),
                "episodes": len(own),
                "cost": float(np.mean([v.mean() for v in costs[arm].values()])),
                "low": low,
                "high": high,
                "upright": float(own["upright"].mean()),
                "overruns": int(own["overruns"].sum()),
            }
            shared = sorted(set(costs[arm]) & set(costs["baseline"]))
            if arm != "baseline" and shared:
                pairs = [costs["baseline"][seed] - costs[arm][seed] for seed in shared]
                low, high = paired_interval(pairs)
                saved = float(np.mean([pair.mean() for pair in pairs]))
                row |= {"saved": saved, "saved_low": low, "saved_high": high}
            rows.append(row)
    columns = ["case", "clock", "arm", "seeds", "episodes", "cost", "low", "high", "upright", "overruns"]
    return pd.DataFrame(rows, columns=[*columns, "saved", "saved_low", "saved_high"])


def _selection_minutes(training: int) -> float:
    """Time on the unit for the episodes that tell which weights are best [min]."""
    config = TrainingConfig()
    iterations = 1 + math.ceil(max(0, training - config.first_episodes) / config.iteration_episodes)
    return iterations * SELECTION_EPISODES * EPISODE / 60.0


def _by_seed(table: Any) -> dict[int, np.ndarray]:
    ordered = table.sort_values("episode")
    return {int(seed): own["cost"].to_numpy() for seed, own in ordered.groupby("seed")}


def findings(root: Path, cases: Sequence[Case]) -> pd.DataFrame:
    """What was hidden in each unit and what its diagnosis says.

    Returns:
        One row per case that is diagnosed: case, hidden, verdict, named, gain (share of the held-out error that the
        extension takes away).
    """
    rows = []
    for case in cases:
        path = root / case.name / "diagnosis" / "report.json"
        if not path.exists():
            continue
        report = json.loads(path.read_text(encoding="utf-8"))
        named = [_spoken(c["parameters"]) for c in report["causes"] if c["parameters"]]
        rows.append(
            {
                "case": case.name,
                "hidden": " ".join(f"{case.effect}.{n} {v:g}" for n, v in case.hidden.items()) or "nothing",
                "verdict": report["verdict"],
                "named": "; ".join(named) or "nothing",
                "gain": (report["gain"] or {}).get("reduction_vs_refit"),
            }
        )
    return pd.DataFrame(rows, columns=["case", "hidden", "verdict", "named", "gain"])


def _spoken(parameters: dict[str, Any]) -> str:
    return " ".join(
        f"{n} {e['value']:.4g} [{e['low']:.4g}, {e['high']:.4g}] {e['unit']}" for n, e in parameters.items()
    )


def as_table(summary: Any, found: Any) -> str:
    """The study as a table in Markdown."""
    named = found.set_index("case")
    lines = [
        "| unit | named | as given | refitted | extended | on the unit | saved by extending |",
        "|---|---|---|---|---|---|---|",
    ]
    for (case, clock), group in summary.groupby(["case", "clock"], sort=False):
        rows = group.set_index("arm").to_dict("index")
        cells = [_cost(rows[arm]) if arm in rows else "" for arm in ARMS]
        row = rows.get("extended", {})
        saved = ""
        if np.isfinite(row.get("saved", np.nan)):
            saved = f"{row['saved']:.0f} [{row['saved_low']:.0f}, {row['saved_high']:.0f}]"
        where = "" if clock == "simulated" else " (wall clock)"
        what = [str(named.loc[case, k]) if case in named.index else "" for k in ("hidden", "named")]
        lines.append(" | ".join((f"| {what[0]}{where}", what[1], *cells, saved)) + " |")
    return "\n".join(lines) + "\n"


def _cost(row: dict[str, Any]) -> str:
    return f"{row['cost']:.0f} [{row['low']:.0f}, {row['high']:.0f}], {100 * row['upright']:.0f} %"


def write_results(out: Path, root: Path, cases: Sequence[Case], episodes: pd.DataFrame) -> pd.DataFrame:
    """Write episodes.csv, summary.csv, findings.csv, the figure, PROVENANCE.md and README.md.

    Returns:
        The summary.
    """
    out.mkdir(parents=True, exist_ok=True)
    summary, found = summarise(episodes), findings(root, cases)
    for name, table in (("episodes", episodes), ("summary", summary), ("findings", found)):
        text = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
        _write(out / f"{name}.csv", str(text).encode())
    _write(out / "README.md", _readme(out, root, as_table(summary, found)).encode())
    _write(out / "PROVENANCE.md", f"{as_markdown()}\n".encode())
    simulated = summary[summary["clock"] == "simulated"]
    if not simulated.empty:
        _write(out / "closing_the_loop.png", _figure(simulated, episodes))
    return summary


def _readme(out: Path, root: Path, table: str) -> str:
    training = json.loads((root / "study.json").read_text(encoding="utf-8"))["training_episodes"]
    text = (
        METHOD.format(
            training=training, minutes=training * EPISODE / 60.0, selection=_selection_minutes(training)
        )
        + table
    )
    text += "\n![cost of every seed](closing_the_loop.png)\n"
    path = out / "README.md"
    had = path.read_text(encoding="utf-8") if path.exists() else ""
    return text + (f"\n{had[had.index(READING) :]}" if READING in had else "")


def _figure(summary: Any, episodes: Any) -> bytes:
    names = list(dict.fromkeys(summary["case"]))
    arms = [arm for arm in ARMS if arm in set(summary["arm"])]
    figure, axis = plt.subplots(figsize=(8.0, 1.3 + 0.17 * len(arms) * len(names)), layout="constrained")
    seeds: Any = episodes[episodes["clock"] == "simulated"].groupby(["case", "arm", "seed"])["cost"].mean()
    for place, arm in enumerate(arms):
        own = summary[summary["arm"] == arm]
        y = np.array([names.index(case) for case in own["case"]]) + 0.18 * (place - 0.5 * (len(arms) - 1))
        reach = np.stack((own["cost"] - own["low"], own["high"] - own["cost"])).clip(0.0)
        axis.errorbar(
            own["cost"], y, xerr=reach, fmt="D", ms=4, capsize=2, color=COLOURS[arm], label=LABELS[arm]
        )
        for position, case in zip(y, own["case"], strict=True):
            dots = seeds.loc[case, arm]
            axis.plot(dots, [position] * len(dots), ".", ms=3, color=COLOURS[arm], alpha=0.6)
    axis.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    axis.invert_yaxis()
    axis.set_xscale("log")
    axis.set_xlabel("cost of an episode on the unit: mean, 95 % interval, seeds (dots)")
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(
        FuncFormatter(lambda value, _: f"{value:g}" if value in (200, 500) else "")
    )
    axis.grid(axis="x", alpha=0.3, which="both")
    figure.legend(loc="outside upper center", ncols=len(arms), fontsize=8, title="trained")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    plt.close(figure)
    return buffer.getvalue()


def _write(path: Path, data: bytes) -> None:
    with whole_file(path) as partial:
        partial.write_bytes(data)

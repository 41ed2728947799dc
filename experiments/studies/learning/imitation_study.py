"""Interactive imitation: what a policy costs after how many questions, by the rule that chooses them.

    deepkoco train agent=ppo task=gymnasium task.name=reacher task.id=Reacher-v5 agent.total_episodes=20480 \
        agent.evaluation_every=2560 agent.discount=0.95 agent.log_sigma=-0.7 agent.final_learning_rate=0.1 \
        agent.minibatch=1024 run=runs/reacher
    deepkoco train agent=ppo task=quadrotor_circle run=runs/circle
    python -m experiments.studies.learning.imitation_study --out results/imitation --reacher runs/reacher \
        --circle runs/circle

The pendulum has the optimal controller as its teacher, the others a PPO. All rules get the same demonstration, start
states, networks and numbers of updates. One training after the other; a stopped study goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from baselines.imitation.teachers import Teacher, TeacherError, make_teacher
from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import write_whole_text, writing
from deepkoco.runs.settings import ExperimentError
from experiments.plumbing.provenance import as_markdown, provenance
from experiments.studies.learning.imitation_runs import METHODS, TASKS, make_config, teacher_costs, train

COLOURS = {
    "cloning": "#999999", "dagger": "#000000", "random": "#0072B2", "doubt": "#D55E00", "drawn": "#E69F00",
    "weighted": "#56B4E9",
    "fixed": "#CC79A7", "novelty": "#009E73",
}  # fmt: skip
GOALS = (1.5, 1.1)  # times the teacher's cost: the task is learned, and the teacher equalled
AT = (220, 600, 1000)  # questions at which ratios are compared


def tables(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """All runs of a folder.

    Args:
        folder: Of the results.

    Returns:
        A row for each run, and a row for each evaluation, with `ratio`: the cost over the teacher's from the same
        start states.
    """
    runs, curves = [], []
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        curve, teacher = run.pop("curve"), run.pop("teacher")
        own = {name: run[name] for name in ("task", "method", "seed")}
        ratios = [p["cost"] / teacher["end" if p is curve[-1] else "way"] for p in curve]
        reached = {
            f"questions_to_{goal:g}": next(
                (p["queries"] for p, ratio in zip(curve, ratios, strict=True) if ratio <= goal), np.inf
            )
            for goal in GOALS
        }
        runs.append(
            {
                **run,
                "questions": curve[-1]["queries"],
                "steps": curve[-1]["steps"],
                "cost": curve[-1]["cost"],
                "teacher_cost": teacher["end"],
                "ratio": ratios[-1],
                **reached,
            }
        )
        curves += [{**own, **p, "ratio": ratio} for p, ratio in zip(curve, ratios, strict=True)]
    return pd.DataFrame(runs), pd.DataFrame(curves)


def ratio_at(curve: pd.DataFrame, questions: float) -> float:
    """Ratio of a run after some questions, between evaluations on a straight line; NaN where it asked fewer.

    Args:
        curve: Rows of one run.
        questions: How many.
    """
    asked = curve["queries"].to_numpy(float)
    if not asked[0] <= questions <= asked[-1]:
        return float("nan")
    return float(np.interp(questions, asked, curve["ratio"].to_numpy(float)))


def draw(curves: pd.DataFrame) -> Figure:
    """Cost by the teacher's over questions, geometric mean of the seeds with its 95 % interval.

    Args:
        curves: A row for each evaluation.
    """
    tasks = [task for task in TASKS if task in set(curves["task"])]
    with house_style():
        figure, panels = plt.subplots(
            1, len(tasks), figsize=(4.0 * len(tasks), 3.8), layout="constrained", squeeze=False
        )
        for panel, task in zip(panels[0], tasks, strict=True):
            of_task = pd.DataFrame(curves[curves["task"] == task])
            for method, rows in _groups(of_task, "method"):
                runs = [run for _, run in _groups(rows, "seed")]
                first = max(run["queries"].iloc[0] for run in runs)
                last = min(run["queries"].iloc[-1] for run in runs)
                places = np.geomspace(first, last, 25).clip(first, last)
                values = np.log([[ratio_at(run, place) for run in runs] for place in places])
                bands = np.exp([mean_with_band(value) for value in values])
                colour = COLOURS[method]
                panel.plot(places, bands[:, 0], color=colour, label=METHODS[method].label)
                panel.fill_between(places, bands[:, 1], bands[:, 2], color=colour, alpha=0.15, linewidth=0)
            for goal in GOALS:
                panel.axhline(goal, color="#555555", linestyle="--", linewidth=1)
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.set_xlabel("questions")
            panel.set_title(task)
        panels[0, 0].set_ylabel("cost, as a multiple of the teacher's")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def summary(runs: pd.DataFrame, curves: pd.DataFrame) -> str:
    """Tables in Markdown, one for each task.

    Args:
        runs: A row for each run.
        curves: A row for each evaluation.
    """
    lines = []
    for task in [task for task in TASKS if task in set(runs["task"])]:
        lines += [
            f"**{task}**, teacher {runs[runs['task'] == task]['teacher_cost'].mean():.4g}",
            "",
            "| | "
            + " | ".join(f"questions to {goal:g}: median (least to most), seeds" for goal in GOALS)
            + " | "
            + " | ".join(f"ratio at {n}" for n in AT)
            + " | ratio at the end | questions | steps | processor s |",
            "|---|" + "---|" * (len(GOALS) + len(AT) + 4),
        ]
        for method, rows in _groups(pd.DataFrame(runs[runs["task"] == task]), "method"):
            own = pd.DataFrame(curves[(curves["task"] == task) & (curves["method"] == method)])
            seeds = [run for _, run in _groups(own, "seed")]
            cells = [_reached(np.array(rows[f"questions_to_{goal:g}"], float)) for goal in GOALS]
            cells += [_band([ratio_at(run, n) for run in seeds]) for n in AT]
            cells += [_band(rows["ratio"].tolist()), f"{rows['questions'].mean():.0f}"]
            cells += [f"{rows['steps'].mean():.0f}", f"{rows['cpu_seconds'].mean():.0f}"]
            lines.append(f"| {METHODS[method].label} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def _groups(rows: pd.DataFrame, column: str) -> list[tuple[str, pd.DataFrame]]:
    """Rows by a column, methods in the order of `METHODS`."""
    order = {name: place for place, name in enumerate(METHODS)}
    found = [(str(name), own) for name, own in rows.groupby(column)]
    return sorted(found, key=lambda group: order.get(group[0], 0))


def _reached(questions: np.ndarray) -> str:
    """Median, least and most of questions (n,), infinite where a run has not reached the goal."""

    def text(value: float) -> str:
        return f"{value:.0f}" if np.isfinite(value) else "-"

    middle, least, most = np.median(questions), questions.min(), questions.max()
    if np.isinf(least):
        return f"-, 0 of {len(questions)}"
    count = np.isfinite(questions).sum()
    return f"{text(float(middle))} ({text(least)} to {text(most)}), {count} of {len(questions)}"


def _band(values: Sequence[float]) -> str:
    """Geometric mean with its 95 % interval; "-" where a run has no value."""
    if not np.isfinite(values).all():
        return "-"
    mean, low, high = np.exp(mean_with_band(np.log(values)))
    return f"{mean:.2f} [{low:.2f}, {high:.2f}]"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Cost of imitation by the number of questions.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--tasks", nargs="+", choices=list(TASKS), default=list(TASKS))
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    for task in [name for name, task in TASKS.items() if task.teacher is None]:
        parser.add_argument(f"--{task}", help=f"folder of the trained run that teaches {task}")
    args = parser.parse_args(arguments)
    folder = args.out / "runs"
    torch.set_num_threads(1)
    try:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        for seed in args.seeds:
            for name in args.tasks:
                _train_all(name, seed, args.methods, TASKS[name].teacher or getattr(args, name), folder)
    except (ExperimentError, TeacherError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    runs, curves = tables(folder)
    runs.to_csv(args.out / "runs.csv", index=False, float_format="%.4f")
    curves.to_csv(args.out / "curves.csv", index=False, float_format="%.4f")
    (args.out / "cost_by_questions.png").write_bytes(as_png(draw(curves)))
    print(summary(runs, curves), as_markdown(), sep="\n\n")
    return 0


@cache
def _teacher(reference: str) -> Teacher:
    return make_teacher(reference)


def _train_all(name: str, seed: int, methods: Sequence[str], reference: str | None, folder: Path) -> None:
    """The trainings of one task and seed that are not there yet."""
    if reference is None:
        raise ExperimentError(f"--{name}: give the folder of the trained run that teaches it")
    paths = {method: folder / f"{name}_{method}_{seed}.json" for method in methods}
    missing = {method: path for method, path in paths.items() if not path.exists()}
    if not missing:
        return
    teacher = _teacher(reference)
    costs = teacher_costs(TASKS[name], teacher, seed, make_config("random", reference))
    for method, path in missing.items():
        run = train(TASKS[name], method, reference, teacher, seed)
        about = {
            "task": name,
            "method": method,
            "seed": seed,
            "commit": provenance()["commit"],
            "teacher": costs,
        }
        write_whole_text(path, json.dumps({**about, **run}, indent=1))
        last = run["curve"][-1]
        print(
            f"{name}, {method}, seed {seed}: {last['cost'] / costs['end']:.2f} of the teacher's cost after "
            f"{last['queries']} questions, {run['cpu_seconds']:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())

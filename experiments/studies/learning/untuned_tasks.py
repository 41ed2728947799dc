"""Tasks that nobody tuned on, with default settings and with those as published.

    python -m experiments.studies.learning.untuned_tasks --out untuned --seeds 0 1

What is trained already is not trained again, so an interrupted call is repeated as it was, and a later one may add
tasks or seeds. The folder then holds:

    runs/TASK/VARIANT/seed_S    training runs, weights included, with processor_seconds.txt over all calls
    untuned.csv                 one row per run: its cost and those of its references, as references.json has them
    untuned.png                 the costs by task
    PROVENANCE.md               commit, versions and processor of the last call
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from deepkoco.agent.references.comparison import EDMDC, RANDOM, ZERO
from deepkoco.agent.references.files import read_comparison
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import whole_file, write_whole_text
from deepkoco.runs.train import is_finished
from experiments.plumbing.provenance import as_markdown

OWN = "experiments.studies.learning.untuned_envs"


def _gymnasium(name: str, time_step: float) -> list[str]:
    return ["task=gymnasium", f"task.id={name}", f"agent.model.time_step={time_step}"]


def _dm_control(domain: str, task: str, repeat: int, time_step: float) -> list[str]:
    """A task of the suite that no file of `configs/task` names, settled like those."""
    found = _gymnasium("deepkoco/DmControl-v0", time_step)
    kwargs = (("domain", domain), ("task", task), ("action_repeat", repeat))
    return [*found, *(f"+task.kwargs.{name}={value}" for name, value in kwargs)]


TASKS = {
    "unbounded_cart": _gymnasium(f"{OWN}:UnboundedCart-v0", 0.05),
    "rail_cart": _gymnasium(f"{OWN}:RailCart-v0", 0.05),
    "balance": _gymnasium(f"{OWN}:Balance-v0", 0.02),
    "gymnasium_pendulum": ["task=gymnasium_pendulum"],
    "mountain_car": ["task=gymnasium", "task.id=MountainCarContinuous-v0"],
    "inverted_pendulum": _gymnasium("InvertedPendulum-v5", 0.04),
    "inverted_double_pendulum": _gymnasium("InvertedDoublePendulum-v5", 0.05),
    "gymnasium_reacher": _gymnasium("Reacher-v5", 0.02),
    "dm_cartpole_swingup": ["task=dm_cartpole_swingup"],
    "dm_pendulum_swingup": ["task=dm_pendulum_swingup"],
    "dm_reacher_easy": ["task=dm_reacher_easy"],
    "dm_ball_in_cup_catch": _dm_control("ball_in_cup", "catch", 4, 0.08),
    "dm_finger_spin": _dm_control("finger", "spin", 2, 0.04),
    "dm_point_mass_easy": _dm_control("point_mass", "easy", 4, 0.08),
}
"""Settings of each task: which one, and its time step where the default is not it. No setting of the learning."""
TEN = [
    "unbounded_cart",
    "rail_cart",
    "gymnasium_pendulum",
    "mountain_car",
    "inverted_double_pendulum",
    "gymnasium_reacher",
    "dm_cartpole_swingup",
    "dm_pendulum_swingup",
    "dm_reacher_easy",
    "dm_ball_in_cup_catch",
]
"""Those that are counted, named before the six of them that are new had been run."""
VARIANTS = {
    "as_published": ["+learning=as_published"],
    "default": [],
    "no_warm_start": ["agent.warm_start=0"],
    "no_scale": ["agent.scale=false"],
    "equal_errors": ["agent.relative_cost=0"],
    "last_weights": ["agent.keep=last"],
    "input_shrinkage": ["agent.input_shrinkage=1"],
}
"""Settings by name: as published, the defaults, and the defaults with one switch off."""
PROCESSOR_SECONDS = "processor_seconds.txt"


def train(task: str, variant: str, seed: int, folder: Path, settings: Sequence[str]) -> str:
    """Bring one run to its end.

    Args:
        task: A name of `TASKS`.
        variant: A name of `VARIANTS`.
        seed: Of the run.
        folder: Of the run.
        settings: Further settings, the same for all runs.

    Returns:
        What went wrong, in one line; empty if nothing did.
    """
    if is_finished(folder):
        return ""
    command = [sys.executable, "-m", "deepkoco.cli", "train", *TASKS[task], *VARIANTS[variant], *settings]
    command += [f"seed={seed}", f"run={folder}", "existing=resume"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if folder.is_dir():
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        write_whole_text(folder / PROCESSOR_SECONDS, f"{_processor_seconds(folder) + spent:.1f}\n")
    print((done.stdout.strip().splitlines() or [f"{folder}: nothing said"])[-1], flush=True)
    return (
        ""
        if done.returncode == 0
        else f"{folder}: {(done.stderr.strip().splitlines() or ['no message'])[-1]}"
    )


def _processor_seconds(folder: Path) -> float:
    """Time of a processor that a run took so far [s]."""
    path = folder / PROCESSOR_SECONDS
    return float(path.read_text()) if path.is_file() else 0.0


def row(task: str, variant: str, seed: int, folder: Path) -> dict[str, Any]:
    """What a finished run says of itself, in one row of the table."""
    comparison = read_comparison(folder)
    assert comparison is not None
    others = {reference.name: reference for reference in comparison.references}
    last = pd.read_csv(folder / "metrics.csv").iloc[-1]
    costs = {
        name: others[reference].cost.mean if reference in others else float("nan")
        for name, reference in (("zero_action", ZERO), ("random", RANDOM), ("edmdc", EDMDC))
    }
    own = comparison.own
    found = {
        "task": task,
        "variant": variant,
        "seed": seed,
        "cost": own.mean,
        "low": own.low,
        "high": own.high,
    }
    worse = " + ".join(comparison.named("worse")) or "-"
    return {
        **found,
        **costs,
        "worse_than": worse,
        "better_than_each": not comparison.needs_advice,
        "kept": "EDMDc" if comparison.kept else "network",
        "episodes": last["episodes"],
        "seconds": last["seconds"],
        "processor_seconds": _processor_seconds(folder) or float("nan"),
    }


def draw(table: pd.DataFrame, path: Path) -> None:
    """Costs by task: the variants with their seeds, and the references.

    Args:
        table: Rows as given by `row`.
        path: PNG to write.
    """
    tasks = list(dict.fromkeys(table["task"]))
    columns = {"zero_action": "muted", "random": "muted", "edmdc": "EDMDc"}
    with house_style():
        figure = Figure(figsize=(9.0, 1.7 * len(tasks)))
        panels = figure.subplots(len(tasks), 1, squeeze=False)[:, 0]
        for axes, task in zip(panels, tasks, strict=True):
            chosen = table[table["task"] == task]
            names = [*columns, *(name for name in VARIANTS if name in set(table["variant"]))]
            for place, name in enumerate(names):
                known = name in columns
                values = chosen[name] if known else chosen.loc[chosen["variant"] == name, "cost"]
                colour = COLOURS[columns[name]] if known else COLOURS["DeepKoCo"]
                axes.plot(values, [place] * len(values), "o", color=colour, alpha=0.7)
            axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
            positive = bool((chosen[["cost", *columns]].min() > 0.0).all())
            scale = "log" if positive else "linear"
            axes.set(title=task.replace("_", " "), xscale=scale, ylim=(len(names) - 0.5, -0.5))
        panels[-1].set_xlabel("cost of an episode; a dot is a run, less is better")
        with whole_file(path) as partial:
            partial.write_bytes(as_png(figure))


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Train on tasks that nobody tuned on, before and after.")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder of the study; an old one is gone on with"
    )
    parser.add_argument(
        "--tasks", nargs="+", choices=TASKS, default=list(TEN), help="which tasks (default: ten)"
    )
    parser.add_argument(
        "--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), help="which settings"
    )
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0, 1], help="seeds of the runs (default 0 1)"
    )
    parser.add_argument(
        "--set",
        nargs="*",
        default=[],
        metavar="NAME=VALUE",
        help="settings of all trainings, such as agent.device=cpu",
    )
    args = parser.parse_args(arguments)
    wrong = []
    for task in args.tasks:
        for seed in args.seeds:
            for variant in args.variants:
                folder = args.out / "runs" / task / variant / f"seed_{seed}"
                wrong.append(train(task, variant, seed, folder, args.set))
    return _write(args.out, [text for text in wrong if text])


def _write(out: Path, wrong: Sequence[str]) -> int:
    runs = [
        row(task, variant, int(folder.name.removeprefix("seed_")), folder)
        for task in TASKS
        for variant in VARIANTS
        for folder in sorted((out / "runs" / task / variant).glob("seed_*"))
        if is_finished(folder)
    ]
    if runs:
        table = pd.DataFrame(runs)
        write_whole_text(
            out / "untuned.csv", table.to_csv(index=False, float_format="%.5g", lineterminator="\n")
        )
        write_whole_text(out / "PROVENANCE.md", as_markdown() + "\n")
        draw(table, out / "untuned.png")
        print(table.to_string(index=False, float_format="%.4g"))
        ours = table[(table["variant"] == "default") & table["task"].isin(TEN)]
        for seed, part in ours.groupby("seed"):
            print(
                f"seed {seed}: better than each reference on {part['better_than_each'].sum()} of {len(part)}"
            )
    print(json.dumps({"failed": list(wrong)}), file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

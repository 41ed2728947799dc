"""Trains the demo's two controllers side by side, each in a process of its own."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

POLICIES = ("baseline", "extended")


class DemoError(RuntimeError):
    """A step of the demo failed."""


def train_side_by_side(
    out: Path, model: Path, episodes: int, distractors: str, seed: int, console: Console
) -> None:
    """Train in the simulator as given and in the extended one, one process each.

    Args:
        out: Folder for the two runs and their logs.
        model: model.yaml of the extended simulator.
        episodes: Training episodes.
        distractors: What else the observation holds, as in experiments.train.
        seed: Seed of both runs.
        console: Where the progress is shown.

    Raises:
        DemoError: A training failed; the other one is stopped.
    """
    common = [
        *(sys.executable, "-m", "experiments.train", "task=pendulum"),
        *("task.id=deepkoco/RodPendulumDelay-v0", f"distractors={distractors}", f"seed={seed}"),
        *(f"agent.total_episodes={episodes}", f"agent.noise_last_episode={max(1, 3 * episodes // 4)}"),
        # Later weights may swing up with one swing more than earlier ones; in a simulator it costs nothing to look.
        *("agent.keep=best", "agent.evaluation_episodes=30"),
    ]
    own = {"baseline": [], "extended": [f"+task.kwargs.model={model}"]}
    columns = (TextColumn("{task.description:>10}"), BarColumn(), TextColumn("{task.fields[note]}"))
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as progress:
        tasks = {name: progress.add_task(name, total=episodes, note="") for name in POLICIES}

        def show() -> None:
            for name, task in tasks.items():
                _show_progress(progress, task, out / name / "metrics.csv")

        commands = {name: [*common, *own[name], f"run={out / name}"] for name in POLICIES}
        run_side_by_side(commands, out, show)


def run_side_by_side(
    commands: Mapping[str, list[str]], out: Path, show: Callable[[], None], pause: float = 1.0
) -> None:
    """Run commands at the same time, and stop all of them when one fails.

    Args:
        commands: Name to command line.
        out: Folder for the output of each, NAME.log.
        show: Called while they run.
        pause: Time between two calls [s].

    Raises:
        DemoError: A command ended with another status than 0; holds the end of its output.
    """
    processes: dict[str, subprocess.Popen] = {}
    with contextlib.ExitStack() as files:
        try:
            for name, command in commands.items():
                log = files.enter_context((out / f"{name}.log").open("w"))
                processes[name] = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
            states = dict.fromkeys(commands)
            while None in states.values() and not any(states.values()):
                show()
                time.sleep(pause)
                states = {name: process.poll() for name, process in processes.items()}
        finally:
            for process in processes.values():
                _stop(process)
    for name, status in states.items():
        if status:
            text = (out / f"{name}.log").read_text()[-800:]
            raise DemoError(f"training of {name} ended with status {status}:\n{text}")


def _stop(process: subprocess.Popen) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _show_progress(progress: Progress, task, metrics: Path) -> None:
    if not metrics.exists():
        progress.update(task, note="collecting and fitting the first episodes")
        return
    last = pd.read_csv(metrics).iloc[-1]
    note = f"{last['episodes']:.0f} episodes, cost {last['train/cost']:.0f}"
    progress.update(task, completed=last["episodes"], note=note)

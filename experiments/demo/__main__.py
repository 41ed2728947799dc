"""The main job from end to end: `python -m experiments.demo` (or `make demo`).

A log of a unit is diagnosed, the simulator extended with what was found, DeepKoCo trained among
distractors in the simulator as given and in the extended one, and both controllers run on the unit in
real time. One page shows it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.diagnose.report import write_report
from deepkoco.envs.film import write_clip
from deepkoco.graph.recording import read_log
from deepkoco.unit import load_unit
from experiments.demo.page import Outcome, terminal_table, write_page
from experiments.unit_trials import Trial, run_trial, run_trials, summarise

HERE = Path(__file__).parent
SYSTEM = "rod_pendulum"
POLICIES = ("baseline", "extended")
CONTROL_RATE = 20.0  # [Hz]


class DemoError(RuntimeError):
    """A step of the demo failed."""


def diagnose_log(out: Path) -> Diagnosis:
    """Diagnose the recorded log and write its report."""
    diagnosis = diagnose([read_log(HERE / "log.csv")], SYSTEM)
    write_report(diagnosis, out)
    return diagnosis


def train_side_by_side(out: Path, model: Path, episodes: int, seed: int, console: Console) -> None:
    """Train in the simulator as given and in the extended one, one process each."""
    common = [
        *(sys.executable, "-m", "experiments.train", "env=rod_pendulum"),
        *("env.id=deepkoco/RodPendulumDelay-v0", "distractors=copies", f"seed={seed}"),
        *(f"agent.total_episodes={episodes}", f"agent.noise_last_episode={episodes}"),
    ]
    own = {"baseline": [], "extended": [f"+env.kwargs.model={model}"]}
    columns = (TextColumn("{task.description:>10}"), BarColumn(), TextColumn("{task.fields[note]}"))
    processes = {}
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as progress:
        tasks = {name: progress.add_task(name, total=episodes, note="") for name in POLICIES}
        try:
            for name in POLICIES:
                log = (out / f"{name}.log").open("w")
                command = [*common, *own[name], f"run={out / name}"]
                processes[name] = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
            while any(process.poll() is None for process in processes.values()):
                for name, task in tasks.items():
                    _show_progress(progress, task, out / name / "metrics.csv")
                time.sleep(1.0)
        finally:
            for process in processes.values():
                process.terminate()
    for name, process in processes.items():
        if process.returncode != 0:
            text = (out / f"{name}.log").read_text()[-800:]
            raise DemoError(f"training of {name} ended with status {process.returncode}:\n{text}")


def _show_progress(progress: Progress, task, metrics: Path) -> None:
    if not metrics.exists():
        progress.update(task, note="collecting and fitting the first episodes")
        return
    last = pd.read_csv(metrics).iloc[-1]
    note = f"{last['episodes']:.0f} episodes, cost {last['train/cost']:.0f}"
    progress.update(task, completed=last["episodes"], note=note)


def run_on_unit(out: Path, runs: Path, episodes: int) -> list[Trial]:
    """Run both policies on the unit in real time, and film the first episode of each."""
    unit = load_unit(HERE / "unit.yaml")
    folders = [runs / name for name in POLICIES]
    trials = run_trials(folders, unit, episodes)
    out.mkdir()
    for folder in folders:
        film = run_trial(folder, unit, episode=0, film=True)
        write_clip(out / f"{folder.name}.webm", film.frames, CONTROL_RATE)
    rows = [{k: v for k, v in vars(t).items() if k != "frames"} for t in trials]
    pd.DataFrame(rows).to_csv(out / "trials.csv", index=False)
    return trials


def free_folder(wanted: Path) -> Path:
    """The folder itself, or with the first number behind it that is free: a run is never overwritten."""
    folder, number = wanted, 1
    while folder.exists():
        number += 1
        folder = wanted.with_name(f"{wanted.name}_{number}")
    return folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.demo", description="The main job end to end."
    )
    parser.add_argument(
        "--out", type=Path, default=Path("demo_out"), help="folder (a number is added if it exists)"
    )
    parser.add_argument("--episodes", type=int, default=300, help="training episodes (default 300)")
    parser.add_argument(
        "--unit-episodes", type=int, default=20, help="episodes on the unit for each (default 20)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the training (default 0)")
    args = parser.parse_args(arguments)
    console = Console()
    began = time.perf_counter()
    out = free_folder(args.out)
    out.mkdir(parents=True)

    console.print("[bold]1/4[/] diagnosing a 30 s log of the unit")
    diagnosis = diagnose_log(out / "diagnosis")
    console.print(f"    {'; '.join(diagnosis.names) or diagnosis.verdict} ({diagnosis.seconds:.0f} s)")
    console.print("[bold]2/4[/] training DeepKoCo among distractors, in the simulator as given and extended")
    runs = out / "runs"
    runs.mkdir()
    train_side_by_side(runs, out / "diagnosis" / "model.yaml", args.episodes, args.seed, console)
    console.print(f"[bold]3/4[/] running both on the unit in real time, {args.unit_episodes} episodes each")
    trials = run_on_unit(out / "unit", runs, args.unit_episodes)
    console.print("[bold]4/4[/] drawing the page")
    outcome = Outcome(diagnosis, trials, summarise(trials), out, time.perf_counter() - began)
    page = write_page(outcome)
    console.print(terminal_table(outcome))
    console.print(
        f"[bold]{page}[/] shows it all; {out / 'diagnosis' / 'report.html'} is the whole diagnosis."
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())

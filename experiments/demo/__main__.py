"""The main job from end to end: `python -m experiments.demo` (or `make demo`).

A log of a unit is diagnosed, the simulator extended with what was found, DeepKoCo trained in the simulator as
given and in the extended one, and both controllers run on the unit in real time. One page shows it.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
from rich.console import Console

from deepkoco.analysis.page.analyse import AnalysisOptions, analyse
from deepkoco.analysis.page.page import write_page as write_model_page
from deepkoco.analysis.run_folder import read_trained
from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.diagnose.report.folder import write_report
from deepkoco.envs.film import write_clip
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.graph import draw_timing
from deepkoco.graph.drawing import write_page as write_graph_page
from deepkoco.graph.episodes.episode import episode_of_timing
from deepkoco.logs.recording import LogError, read_log
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.unit_trials import Trial, run_trial, run_trials, summarise
from deepkoco.unit import UnitError, UnitSpecError, load_unit
from experiments.demo.page import Outcome, terminal_table, write_page
from experiments.demo.training import POLICIES, DemoError, train_side_by_side

HERE = Path(__file__).parent
SYSTEM = "rod_pendulum"
EXTENDED = "deepkoco/RodPendulumDelay-v0"  # the environment that takes a model of the unit
CONTROL_RATE = 20.0  # [Hz]


def diagnose_log(out: Path) -> Diagnosis:
    """Diagnose the recorded log and write its report."""
    diagnosis = diagnose([read_log(HERE / "log.csv")], SYSTEM)
    write_report(diagnosis, out)
    return diagnosis


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


def show_model(run: Path) -> None:
    """Write the page of a trained model into its run."""
    trained = read_trained(run, None)
    options = AnalysisOptions(episodes=12, exploring_episodes=60, prunings=4, film_plans=60)
    write_model_page(analyse(trained, options, {}, lambda *_: None), run / "analysis.html")


def show_graph(model: Path, page: Path) -> None:
    """Write the page of the graph that the extended simulation runs on, with the timing of an episode."""
    envs = gymnasium.make_vec(EXTENDED, 1, vectorization_mode="vector_entry_point", model=str(model))
    assert isinstance(envs, GraphVectorEnv)
    timing = draw_timing(envs.graph, np.random.default_rng(0), 100, batch=1)
    episode = episode_of_timing(envs.graph, timing)
    envs.close()
    write_graph_page(page, envs.graph, episode, "The extended simulation as a graph")


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
        "--distractors",
        default="none",
        help="what else the observation holds, as in experiments.train (default none)",
    )
    parser.add_argument(
        "--unit-episodes", type=int, default=20, help="episodes on the unit for each (default 20)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the training (default 0)")
    args = parser.parse_args(arguments)
    for name in ("episodes", "unit_episodes"):
        if getattr(args, name) < 1:
            parser.error(f"--{name.replace('_', '-')} {getattr(args, name)}: give at least 1")
    if args.seed < 0:
        parser.error(f"--seed {args.seed}: give 0 or more")
    out = free_folder(args.out)
    try:
        out.mkdir(parents=True)
    except OSError as error:
        parser.error(f"--out {args.out}: {error.strerror}")
    try:
        run_demo(out, args.episodes, args.unit_episodes, args.distractors, args.seed, Console())
    except (*BAD_INPUT, DemoError, LogError, UnitError, UnitSpecError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def run_demo(
    out: Path, episodes: int, unit_episodes: int, distractors: str, seed: int, console: Console
) -> None:
    """Do the whole job.

    Args:
        out: Empty folder for everything.
        episodes: Training episodes.
        unit_episodes: Episodes on the unit for each controller.
        distractors: What else the observation holds.
        seed: Seed of the training.
        console: Where it tells how far it is.
    """
    began = time.perf_counter()
    console.print("[bold]1/4[/] diagnosing a 30 s log of the unit")
    diagnosis = diagnose_log(out / "diagnosis")
    console.print(f"    {'; '.join(diagnosis.names) or diagnosis.verdict} ({diagnosis.seconds:.0f} s)")
    console.print("[bold]2/4[/] training DeepKoCo in the simulator as given and extended")
    runs = out / "runs"
    runs.mkdir()
    train_side_by_side(runs, out / "diagnosis" / "model.yaml", episodes, distractors, seed, console)
    console.print(f"[bold]3/4[/] running both on the unit in real time, {unit_episodes} episodes each")
    trials = run_on_unit(out / "unit", runs, unit_episodes)
    console.print("[bold]4/4[/] drawing the pages")
    show_model(runs / "extended")
    show_graph(out / "diagnosis" / "model.yaml", out / "graph.html")
    outcome = Outcome(diagnosis, trials, summarise(trials), out, time.perf_counter() - began, distractors)
    page = write_page(outcome)
    console.print(terminal_table(outcome))
    console.print(
        f"[bold]{page}[/] shows it all; {out / 'diagnosis' / 'report.html'} is the whole diagnosis."
    )


if __name__ == "__main__":
    sys.exit(main())

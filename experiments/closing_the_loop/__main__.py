"""What naming a hidden effect is worth in control: `python -m experiments.closing_the_loop --seeds 0 1 2 --json`.

For each hidden effect: a unit is recorded and diagnosed; DeepKoCo is trained in the simulator as given, in the refitted
one, in the extended one and on the unit itself; all run on the unit from the same start states. What is there already
in `--runs` is not done again, so the same command goes on after a kill.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from deepkoco.logs.recording import LogError
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.unit import UnitError, UnitSpecError
from experiments.closing_the_loop.hidden import EFFECTS, NOTHING, STRENGTHS, Case, cases
from experiments.closing_the_loop.steps import (
    ARMS,
    SELECTION_EPISODES,
    TrainingError,
    evaluate,
    prepare,
    refusal,
    train,
    write_once,
)
from experiments.closing_the_loop.summary import write_results

RUNS = Path("runs/closing_the_loop")
OUT = Path("results/diagnose/closing_the_loop")
CLOCKS = ("simulated", "wall")


def run_study(
    runs: Path,
    out: Path,
    units: Sequence[Case],
    arms: Sequence[str],
    seeds: Sequence[int],
    training: int,
    episodes: int,
    clock: str,
    report: Callable[[str], None],
) -> pd.DataFrame:
    """Do what is not done yet and write the results after every unit.

    Args:
        runs: Folder of units, logs, trainings and trials.
        out: Folder of the results.
        units: What is hidden.
        arms: Where policies are trained.
        seeds: Seeds of the trainings.
        training: Episodes of a training.
        episodes: Episodes of each policy on the unit.
        clock: "simulated" or "wall".
        report: Told a line for every policy.

    Returns:
        The summary.

    Raises:
        ExperimentError: The folders hold another study.
        TrainingError: A training failed.
    """
    runs.mkdir(parents=True, exist_ok=True)
    study = {"training_episodes": training, "selection_episodes": SELECTION_EPISODES}
    write_once(runs / "study.json", json.dumps(study) + "\n")
    for case in units:
        prepare(case, runs / case.name)
    summary = pd.DataFrame()
    # Seed by seed, so that a study that is stopped compares all units on fewer seeds.
    for seed in seeds:
        for case in units:
            for arm in arms:
                if (reason := refusal(arm, runs / case.name)) is not None:
                    report(f"{case.name}, seed {seed}, {arm}: not trained: {reason}")
                    continue
                train(runs, case, arm, seed, training)
                found = evaluate(runs, case, arm, seed, episodes, clock)
                upright = 100 * found["upright"].mean()
                report(
                    f"{case.name}, seed {seed}, {arm}: cost {found['cost'].mean():.0f}, {upright:.0f} % upright"
                )
            episodes_so_far = collected(runs)
            if not episodes_so_far.empty:  # every arm of the first unit may have been refused
                summary = write_results(out, runs, all_cases(), episodes_so_far)
    return summary


def all_cases() -> list[Case]:
    """Every unit that the study knows."""
    return cases([NOTHING, *EFFECTS], list(STRENGTHS))


def collected(runs: Path) -> pd.DataFrame:
    """Every episode on every unit so far: case, arm, seed, clock, episode, cost, upright, overruns."""
    tables = []
    for case in all_cases():
        for path in sorted((runs / case.name / "trials").glob("*.csv")):
            arm, rest = path.stem.split("_seed_")
            seed, clock = rest.split("_")
            tables.append(pd.read_csv(path).assign(case=case.name, arm=arm, seed=int(seed), clock=clock))
    columns = ["case", "arm", "seed", "clock", "episode", "cost", "upright", "overruns"]
    if not tables:
        return pd.DataFrame(columns=columns)
    table: Any = pd.concat(tables, ignore_index=True)
    return table[columns]


def as_json(summary: pd.DataFrame) -> str:
    """The summary's rows as one line of JSON, with null where there is nothing to compare."""
    rows = [
        {str(k): None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}
        for row in summary.to_dict("records")
    ]
    return json.dumps(rows, allow_nan=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.closing_the_loop",
        description="What naming a hidden effect is worth in control.",
    )
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0, 1, 2], help="seeds of the trainings (default 0 1 2)"
    )
    effects = [NOTHING, *EFFECTS]
    parser.add_argument("--effects", nargs="+", choices=effects, default=effects, help="default: all")
    parser.add_argument(
        "--strengths", nargs="+", choices=STRENGTHS, default=list(STRENGTHS), help="default: both"
    )
    parser.add_argument(
        "--arms", nargs="+", choices=ARMS, default=list(ARMS), help="where to train; default: all"
    )
    parser.add_argument("--training-episodes", type=int, default=400, help="of each training (default 400)")
    parser.add_argument("--episodes", type=int, default=50, help="of each policy on the unit (default 50)")
    parser.add_argument("--clock", choices=CLOCKS, default="simulated", help="of the trials on the unit")
    parser.add_argument("--runs", type=Path, default=RUNS, help=f"folder to go on in (default {RUNS})")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder of the results (default {OUT})")
    parser.add_argument("--json", action="store_true", help="print the summary as one line of JSON")
    args = parser.parse_args(arguments)
    for name in ("episodes", "training_episodes"):
        if getattr(args, name) < 1:
            parser.error(f"--{name.replace('_', '-')} {getattr(args, name)}: give at least 1")
    if min(args.seeds) < 0:
        parser.error(f"--seeds {min(args.seeds)}: give 0 or more")
    units = cases(args.effects, args.strengths)
    stream = sys.stderr if args.json else sys.stdout
    try:
        summary = run_study(
            args.runs, args.out, units, [a for a in ARMS if a in args.arms], args.seeds, args.training_episodes,
            args.episodes, args.clock, lambda line: print(line, file=stream, flush=True),
        )  # fmt: skip
    except (*BAD_INPUT, TrainingError, LogError, UnitError, UnitSpecError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if args.json:
        print(as_json(summary))
    else:
        page = args.out / "README.md"
        print(page.read_text(encoding="utf-8") if page.exists() else "nothing has run on a unit yet")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The steps of the study; each leaves files and is not done again where they are there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import pandas as pd

from deepkoco.diagnose import Diagnosis, diagnose, write_report
from deepkoco.envs.settings import SettingsError
from deepkoco.excitation.record import record
from deepkoco.logs.recording import read_log, write_log
from deepkoco.output.whole_file import write_whole_text
from deepkoco.runs.settings import ExperimentError
from deepkoco.runs.train import is_finished
from deepkoco.runs.unit_trials import run_trials
from deepkoco.systems import ExtendedSystem, MemoryEffectError, make_system, save_model
from deepkoco.unit import load_unit
from experiments.studies.diagnosis.closing_the_loop.hidden import SYSTEM, Case

LOG_SECONDS, LOG_SEED = 30.0, 3
# Past actions in the observation, so that a policy trained with a delay can know what is under way; the same for all.
ACTION_HISTORY = 3
SELECTION_EPISODES = 30  # after every iteration of a training, to keep the best weights
SIMULATOR = "deepkoco/RodPendulumDelay-v0"
UNIT = "deepkoco/Unit-v0"
ARMS = ("baseline", "refit", "extended", "unit")
"""Where a policy is trained: in the simulator as given, with its own parameters refitted to the log, extended with what
was named, and on the unit itself, which no robot would live through."""


class TrainingError(RuntimeError):
    """A training ended with an error."""


def prepare(case: Case, folder: Path) -> None:
    """Make the unit, record its log and diagnose it.

    Args:
        case: What is hidden.
        folder: Of the case; holds unit.yaml, log.csv, diagnosis/ and refit.yaml afterwards.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_once(folder / "unit.yaml", case.unit_file())
    if not (folder / "log.csv").exists():
        unit = load_unit(folder / "unit.yaml")
        write_log(folder / "log.csv", record(unit, "steps", LOG_SECONDS, clock="simulated", seed=LOG_SEED))
    if not (folder / "refit.yaml").exists() or not (folder / "diagnosis").exists():
        diagnosis = diagnose([read_log(folder / "log.csv")], SYSTEM)
        if not (folder / "diagnosis").exists():
            write_report(diagnosis, folder / "diagnosis")
        if not (folder / "refit.yaml").exists():
            save_model(folder / "refit.yaml", refitted(diagnosis), {"logs": ["log.csv"]})


def refitted(diagnosis: Diagnosis) -> ExtendedSystem:
    """The simulator with its own parameters as the log has them, and nothing added."""
    values = {name: estimate.value for name, estimate in diagnosis.refit.items() if "." not in name}
    return ExtendedSystem(make_system(SYSTEM), (), values)


def model_of(arm: str, folder: Path) -> Path | None:
    """Model file that an arm trains in; None: the simulator as given, or the unit itself."""
    return {"refit": folder / "refit.yaml", "extended": folder / "diagnosis" / "model.yaml"}.get(arm)


def refusal(arm: str, folder: Path) -> str | None:
    """Why the simulator of an arm cannot be trained in; None where it can."""
    model = model_of(arm, folder)
    if model is None:
        return None
    if not model.exists():
        return "the log did not suffice for a model"
    try:
        gymnasium.make(SIMULATOR, model=str(model)).close()
    except SettingsError as error:
        if not isinstance(error.__cause__, MemoryEffectError):
            raise
        return str(error.__cause__)
    return None


def run_folder(root: Path, case: Case, arm: str, seed: int) -> Path:
    """Folder of a training run: the simulator as given is the same for all units."""
    return (root if arm == "baseline" else root / case.name) / arm / f"seed_{seed}"


def training_command(root: Path, case: Case, arm: str, seed: int, episodes: int) -> list[str]:
    """Command line that trains, or goes on training, one policy."""
    folder = root / case.name
    if arm == "unit":
        # In simulated time: 90 units side by side in real time would overrun every period of this machine.
        where = [
            f"task.id={UNIT}",
            f"+task.kwargs.unit={folder / 'unit.yaml'}",
            "+task.kwargs.clock=simulated",
        ]
    else:
        # Noise as of the sensor, for the unit has it too.
        model = model_of(arm, folder)
        where = [f"task.id={SIMULATOR}", "+task.kwargs.noise=true"]
        where += [] if model is None else [f"+task.kwargs.model={model}"]
    return [
        *(sys.executable, "-m", "experiments.train", "task=pendulum", *where),
        *(f"+task.kwargs.action_history={ACTION_HISTORY}", "distractors=none", f"seed={seed}"),
        *(f"agent.total_episodes={episodes}", f"agent.noise_last_episode={max(1, 3 * episodes // 4)}"),
        *("agent.keep=best", f"agent.evaluation_episodes={SELECTION_EPISODES}"),
        *("existing=resume", f"run={run_folder(root, case, arm, seed)}"),
    ]


def train(root: Path, case: Case, arm: str, seed: int, episodes: int) -> None:
    """Train one policy; a run that was killed goes on where it was.

    Raises:
        TrainingError: It ended with another status than 0.
    """
    run = run_folder(root, case, arm, seed)
    if run.exists() and is_finished(run):
        return
    run.parent.mkdir(parents=True, exist_ok=True)
    log = run.with_name(f"{run.name}.log")
    with log.open("a") as output:
        command = training_command(root, case, arm, seed, episodes)
        status = subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, check=False).returncode
    if status:
        raise TrainingError(f"{' '.join(command)} ended with status {status}:\n{log.read_text()[-800:]}")


def evaluate(root: Path, case: Case, arm: str, seed: int, episodes: int, clock: str) -> pd.DataFrame:
    """Costs of one policy on the unit, from start states that are the same for all policies.

    Returns:
        One row per episode: episode, cost, upright, overruns.

    Raises:
        ExperimentError: There are episodes already, fewer or more than asked for.
    """
    folder = root / case.name
    path = folder / "trials" / f"{arm}_seed_{seed}_{clock}.csv"
    if not path.exists():
        unit = load_unit(folder / "unit.yaml")
        trials = run_trials([run_folder(root, case, arm, seed)], unit, episodes, clock)
        rows: list[dict[str, Any]] = [
            {"episode": t.episode, "cost": t.cost, "upright": t.upright, "overruns": t.overruns}
            for t in trials
        ]
        path.parent.mkdir(exist_ok=True)
        write_once(path, str(pd.DataFrame(rows).to_csv(index=False, float_format="%.6g")))
    table = pd.read_csv(path)
    if len(table) != episodes:
        raise ExperimentError(
            f"{path}: holds {len(table)} episodes, not {episodes}; repeat with --episodes {len(table)}, or remove it"
        )
    return table


def write_once(path: Path, text: str) -> None:
    """Write a file whole, unless it is there; a file of other content is refused.

    Raises:
        ExperimentError: The file holds something else.
    """
    if path.exists():
        if path.read_text(encoding="utf-8") != text:
            raise ExperimentError(f"{path}: is of another study; choose another --runs")
        return
    write_whole_text(path, text)

"""`deepkoco train`: train an agent in a folder of its own, or go on with a run."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text
from yaml import YAMLError

from deepkoco.agent.config import OLDER_SETTINGS
from deepkoco.agent.references.files import read_comparison
from deepkoco.agent.standing import Standing
from deepkoco.agent.training import CHECKPOINT_FILE, MODEL_FOLDER
from deepkoco.envs.task_files import find_files, keep_copies, with_absolute_paths
from deepkoco.output.whole_file import WriteError, writing
from deepkoco.runs.agents import settings_class, trainer_class
from deepkoco.runs.environments import make_environments
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.prolong import prolong
from deepkoco.runs.run_lock import locked
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from deepkoco.yaml_file import read_yaml

CONFIG_FILE = "config.yaml"


def load_run_config(folder: Path) -> TrainRunConfig:
    """Read the settings stored with a run.

    Args:
        folder: The run's folder.

    Returns:
        The settings.

    Raises:
        ExperimentError: There are none, or this release cannot read them.
    """
    path = folder / CONFIG_FILE
    if not path.is_file():
        raise ExperimentError(f"{folder}: no {CONFIG_FILE}; give the folder of a training run")
    try:
        read_yaml(path)  # OmegaConf has no bound on the size of a file
        stored = OmegaConf.load(path)
        # Runs from before there was a choice do not name their agent.
        name = OmegaConf.select(stored, "agent.name", default="deepkoco")
        schema = OmegaConf.structured(TrainRunConfig(agent=settings_class(name)()))
        older = {"agent": OLDER_SETTINGS} if name == "deepkoco" else {}
        config = OmegaConf.to_object(OmegaConf.merge(schema, older, stored))
    except (OmegaConfBaseException, YAMLError, OSError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split()).removeprefix(f"{path}: ")
        raise ExperimentError(f"{path}: not the settings of a run this release reads: {reason}") from error
    assert isinstance(config, TrainRunConfig)
    return config


def is_finished(folder: Path) -> bool:
    """Whether a run came to its end: its model is there."""
    return (folder / MODEL_FOLDER).is_dir()


def check_finished(folder: Path) -> None:
    """Check that a run came to its end.

    Args:
        folder: The run's folder.

    Raises:
        ExperimentError: It did not.
    """
    if not is_finished(folder):
        raise ExperimentError(
            f"{folder}: this run is not finished; continue it with deepkoco train resume={folder}"
        )


def prepare_folder(config: TrainRunConfig) -> tuple[TrainRunConfig, Path, bool]:
    """Make a new run's folder, or find the one to resume.

    Args:
        config: Settings given by the user.

    Returns:
        The settings that hold for the run, its folder, and whether the folder is new.

    Raises:
        ExperimentError: A setting is wrong, a new run's folder exists, or a run to resume does not.
        TrainingConfigError: A hyper-parameter is out of range.
        PlannerConfigError: A setting of the planner is out of range.
    """
    config.check()
    config.task.kwargs = with_absolute_paths(config.task.kwargs)
    if config.resume is not None:
        folder = Path(config.resume)
        return load_run_config(folder), folder, False
    folder = Path(config.run)
    if folder.exists():
        if config.existing == "refuse":
            raise ExperimentError(
                f"{folder}: exists already; choose another run= or continue it with resume={folder}"
            )
        return _same_settings(config, folder), folder, False
    make_environments(config)
    config.agent.check()
    # The folder appears with its settings inside, so a kill leaves one that can be resumed, or none.
    partial = folder.with_name(f"{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        with writing(folder, partial):
            partial.mkdir(parents=True)
            keep_copies(config.task.kwargs, partial)
            OmegaConf.save(OmegaConf.structured(config), partial / CONFIG_FILE, resolve=True)
            partial.replace(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    return config, folder, True


def _same_settings(config: TrainRunConfig, folder: Path) -> TrainRunConfig:
    """The settings stored in a folder, which must be those given."""
    stored = load_run_config(folder)
    stored.task.kwargs = with_absolute_paths(stored.task.kwargs)
    given, there = config.identity(), stored.identity()
    names = [name for name in given | there if given.get(name) != there.get(name)]
    if names:
        texts = ", ".join(f"{name} = {there.get(name)} instead of {given.get(name)}" for name in names)
        raise ExperimentError(f"{folder}: holds a run with {texts}; choose another run=")
    return stored


def train(given: TrainRunConfig) -> None:
    """Train to the end, with a progress bar on a terminal.

    Args:
        given: Settings of the command.
    """
    settings = [setting.lstrip("+") for setting in HydraConfig.get().overrides.task]
    longer = any(setting.startswith("agent.total_episodes=") for setting in settings)
    others = [s for s in settings if not s.startswith(("resume=", "threads=", "agent.total_episodes="))]
    if given.resume is not None and others:
        raise ExperimentError(
            f"resume= continues with the stored settings; leave out {' '.join(others)} (more agent.total_episodes "
            "prolong a run)"
        )
    config, folder, new = prepare_folder(given)
    # A launcher that was killed may have left a process that still trains: an aborted sweep waits for it.
    with locked(folder / CONFIG_FILE, wait=given.existing == "resume"):
        if given.existing == "resume" and not new and is_finished(folder):
            print(f"{folder}: finished already", flush=True)
            return
        if given.resume is not None and longer:
            config = _prolonged(config, folder, given.agent.total_episodes)
        torch.set_num_threads(given.threads)
        try:
            _train(config, folder)
        except BAD_INPUT as error:
            # Without a checkpoint there is nothing to lose, and the folder would block the corrected command.
            kept = (folder / CHECKPOINT_FILE).exists()
            if new and not kept:
                shutil.rmtree(folder)
            if kept and isinstance(error, WriteError):
                raise ExperimentError(
                    f"{error}; then go on from the last checkpoint with resume={folder}"
                ) from error
            raise


def _prolonged(config: TrainRunConfig, folder: Path, total: int) -> TrainRunConfig:
    """The settings of a longer run, with a line that says what it is."""
    longer, difference = prolong(config, folder, total, CONFIG_FILE)
    said = (
        f"unlike a run of {total} from the start: {difference}"
        if difference
        else f"as a run of {total} from the start"
    )
    line = f"{folder}: goes on to {total} episodes, {said}"
    last = getattr(config.agent, "noise_last_episode", total)
    if last < total:
        line += f"; without exploration from episode {last} on (agent.noise_last_episode)"
    print(line, flush=True)
    return longer


def _draws_progress() -> bool:
    """Whether there is a terminal and no other run beside this one that would draw on it too."""
    one_by_one = HydraConfig.get().launcher["_target_"].endswith(".BasicLauncher")
    return sys.stdout.isatty() and one_by_one


def _train(config: TrainRunConfig, folder: Path) -> None:
    config.task.kwargs = find_files(config.task.kwargs, folder)
    evaluation = make_environments(config, "evaluation")
    description = {
        "name": config.task.name,
        "id": config.task.id,
        "kwargs": config.task.kwargs,
        "observation": config.observation,
        "distractors": config.distractors,
    }
    make = trainer_class(config.agent.name)
    trainer = make(make_environments(config), config.agent, config.seed, folder, evaluation, description)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[text]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, disable=not _draws_progress()) as bar:
        task = bar.add_task(str(folder), text="")

        def show(standing: Standing) -> None:
            bar.update(task, total=standing.total, completed=standing.completed, text=standing.text)
            if standing.note:
                bar.console.print(f"{folder}: {standing.note}", markup=False, highlight=False, soft_wrap=True)
            # A log file gets a line for every row in the place of the bar.
            if bar.disable and standing.row is not None:
                done = standing.row
                print(
                    f"{folder}: {done['episodes']:.0f} episodes, training cost {done['train/cost']:.0f}, "
                    f"noise-free cost {done['evaluation/cost']:.0f}, {done['seconds']:.0f} s",
                    flush=True,
                )

        last = trainer.run(show)
    print(
        f"{folder}: noise-free cost {last['evaluation/cost']:.1f} "
        f"over {last['evaluation/episodes']:.0f} episodes "
        f"after {last['episodes']:.0f} training episodes, "
        f"{last['updates']:.0f} updates, {last['seconds']:.0f} s",
        flush=True,
    )
    _say_comparison(folder)


def _say_comparison(folder: Path) -> None:
    """The last line of a training: what it was worth, in bold and red on a terminal where it is not better."""
    comparison = read_comparison(folder)
    if comparison is None:
        return
    style = "bold red" if comparison.needs_advice else "bold green"
    line = Text(f"{folder}: {comparison.line}", style=style)
    Console(file=sys.stdout, soft_wrap=True).print(line)
    sys.stdout.flush()

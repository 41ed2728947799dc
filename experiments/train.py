"""Train DeepKoCo: `python -m experiments.train env=rod_pendulum seed=0 distractors=none run=RUN`."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from deepkoco.agent.metrics import Row
from deepkoco.agent.training import Progress as TrainingProgress
from deepkoco.agent.training import Trainer
from experiments.commands import run_command
from experiments.environments import ExperimentError, make_factory
from experiments.settings import TrainRunConfig

CONFIG_FILE = "config.yaml"


def load_run_config(folder: Path) -> TrainRunConfig:
    """Read the settings stored with a run.

    Args:
        folder: The run's folder.

    Returns:
        The settings.

    Raises:
        ExperimentError: There are none.
    """
    path = folder / CONFIG_FILE
    if not path.is_file():
        raise ExperimentError(f"{folder}: no {CONFIG_FILE}; give the folder of a training run")
    merged = OmegaConf.merge(OmegaConf.structured(TrainRunConfig), OmegaConf.load(path))
    config = OmegaConf.to_object(merged)
    assert isinstance(config, TrainRunConfig)
    return config


def prepare_folder(config: TrainRunConfig) -> tuple[TrainRunConfig, Path]:
    """Make a new run's folder, or find the one to resume.

    Args:
        config: Settings given by the user.

    Returns:
        The settings that hold for the run, and its folder.

    Raises:
        ExperimentError: A new run's folder exists, or a run to resume does not.
    """
    if config.resume is not None:
        folder = Path(config.resume)
        return load_run_config(folder), folder
    folder = Path(config.run)
    if folder.exists():
        raise ExperimentError(
            f"{folder}: exists already; choose another run= or continue it with resume={folder}"
        )
    make_factory(config.env, config.distractors)
    config.agent.check()
    folder.mkdir(parents=True)
    partial = folder / f"{CONFIG_FILE}.partial"
    OmegaConf.save(OmegaConf.structured(config), partial, resolve=True)
    partial.replace(folder / CONFIG_FILE)
    return config, folder


def train(given: TrainRunConfig) -> None:
    """Train to the end, with a progress bar on a terminal.

    Args:
        given: Settings of the command.
    """
    others = [
        o for o in HydraConfig.get().overrides.task if not o.lstrip("+").startswith(("resume=", "threads="))
    ]
    if given.resume is not None and others:
        raise ExperimentError(f"resume= continues with the stored settings; leave out {' '.join(others)}")
    torch.set_num_threads(given.threads)
    config, folder = prepare_folder(given)
    trainer = Trainer(make_factory(config.env, config.distractors), config.agent, config.seed, folder)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[cost]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, disable=not sys.stdout.isatty()) as bar:
        task = bar.add_task(str(folder), cost="")

        def show(progress: TrainingProgress, planned: int, row: Row) -> None:
            text = f"iteration {progress.iteration + 1}, training cost {row['train/cost']:.0f}"
            bar.update(task, total=planned, completed=progress.iteration_updates, cost=text)

        last = trainer.run(show)
    print(
        f"{folder}: noise-free cost {last['evaluation/cost']:.1f} "
        f"over {last['evaluation/episodes']:.0f} episodes "
        f"after {last['episodes']:.0f} training episodes, "
        f"{last['updates']:.0f} updates, {last['seconds']:.0f} s"
    )


if __name__ == "__main__":
    run_command("train", train)

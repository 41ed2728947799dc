"""What a training run, or a model that was given away, says about itself."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from deepkoco.agent.stored_controller import StoredController, read_controller
from deepkoco.envs.distractors import DistractorOptions
from deepkoco.envs.task_factory import TaskConfig
from deepkoco.envs.task_files import find_files
from deepkoco.koopman.files.folder_files import ModelFolderError
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.planning.config import PlannerConfig
from deepkoco.yaml_file import YamlFileError, read_yaml

SETTINGS_FILE = "config.yaml"


class RunFolderError(ValueError):
    """A folder is neither a finished training run nor a model folder that says its task."""


@dataclass
class TaskSettings:
    """The settings of a run that say what the agent saw and did."""

    task: TaskConfig = field(default_factory=TaskConfig)
    """The environment."""
    seed: int = 0
    """Of the run; it fixes the order of the entries under distractors."""
    observation: str = "states"
    """"states" or "images"."""
    distractors: str = "none"
    """Names of distractors joined by "+"."""
    distractor_options: DistractorOptions = field(default_factory=DistractorOptions)
    """How strong they are."""


@dataclass(frozen=True)
class TrainedRun:
    """A trained model with its task.

    Attributes:
        path: Folder as the user gave it.
        model: The latent model.
        planner: Settings of the planner.
        action_low, action_high: Limits (M,).
        settings: Task and distractors.
        trained_horizon: T of the training; None where it is not stored.
        details: All stored settings, for the page.
        is_run: Whether it is a run with metrics, or a bare model.
    """

    path: Path
    model: LatentModel
    planner: PlannerConfig
    action_low: Array
    action_high: Array
    settings: TaskSettings
    trained_horizon: int | None
    details: dict[str, Any]
    is_run: bool


def read_trained(path: Path, task: str | None = None) -> TrainedRun:
    """Read a finished run, or a model folder.

    Args:
        path: The folder.
        task: A registered Gymnasium id, for models that do not say theirs.

    Returns:
        Model, task and settings.

    Raises:
        RunFolderError: It is neither, the run is not finished, or the task is not known.
    """
    is_run = (path / SETTINGS_FILE).is_file()
    if is_run and not (path / "model").is_dir():
        raise RunFolderError(
            f"{path}: this run is not finished, it has no model yet; train it to its end first"
        )
    try:
        stored = read_controller(path)
    except ModelFolderError as error:
        raise RunFolderError(str(error)) from error
    details = _read_settings(path / SETTINGS_FILE) if is_run else _as_settings(stored)
    if task is not None:
        settings = TaskSettings(TaskConfig(name=task, id=task))
    elif isinstance(details.get("task"), dict) and details["task"].get("id"):
        settings = _task_settings(details, path)
        settings.task.kwargs = find_files(settings.task.kwargs, path)
    else:
        raise RunFolderError(
            f"{path}: does not say which task it belongs to; give --task with a Gymnasium id"
        )
    agent = details.get("agent", {})
    horizon = agent.get("horizon") if isinstance(agent, dict) else None
    trained = horizon if isinstance(horizon, int) else None
    limits = stored.action_low, stored.action_high
    return TrainedRun(path, stored.model, stored.planner, *limits, settings, trained, details, is_run)


def _as_settings(stored: StoredController) -> dict[str, Any]:
    """What a model folder says, in the form of the settings of a run."""
    task = dict(stored.task)
    seen = {name: task[name] for name in ("observation", "distractors", "distractor_options") if name in task}
    found = {"task": task, **seen, "planner": asdict(stored.planner), "training": dict(stored.training)}
    if "seed" in stored.training:
        found["seed"] = stored.training["seed"]
    return found


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        settings = read_yaml(path)
    except YamlFileError as error:
        raise RunFolderError(f"{path.parent}: not the settings of a run: {error}") from error
    if not isinstance(settings, dict):
        raise RunFolderError(f"{path}: not the settings of a run: it holds no named entries")
    return settings


def _task_settings(details: dict[str, Any], path: Path) -> TaskSettings:
    known = {
        name: details[name] for name in TaskSettings.__dataclass_fields__ if details.get(name) is not None
    }
    known["task"] = {
        name: details["task"][name] for name in TaskConfig.__dataclass_fields__ if name in details["task"]
    }
    try:
        settings = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(TaskSettings), known))
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise RunFolderError(f"{path}: the stored task is not one this release reads: {reason}") from error
    assert isinstance(settings, TaskSettings)
    return settings

"""What a controller is made of, read from the folder of a model: model, planner, limits, what it is for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.koopman.exported import Array
from deepkoco.koopman.files.folder_files import CONFIG_FILE, ModelFolderError
from deepkoco.koopman.files.model_folder import read_model_folder, write_model_folder
from deepkoco.koopman.files.stored_values import number_above, text, whole_number
from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.config import PlannerConfig

MODEL_FOLDER = "model"
MOST_PLANNED = 2_000
"""Most planned numbers (steps times actions) of a stored planner; a quadratic program has their square."""
MOST_SAMPLED = 10_000_000
"""Most numbers that a stored planner draws per decision."""
LARGEST_LIMIT = 1e20
"""Largest limit of an action; solvers take numbers from here on as infinite."""


@dataclass(frozen=True)
class StoredController:
    """A latent model with its planner's settings.

    Attributes:
        model: The latent model.
        planner: Settings of the planner.
        action_low: a_min (M,).
        action_high: a_max (M,).
        task: What it controls: name, Gymnasium id, arguments, distractors, observation, action_units; as far
            as known.
        training: Where it comes from: seed, episodes, package; as far as known.
    """

    model: LatentModel
    planner: PlannerConfig
    action_low: Array
    action_high: Array
    task: Mapping[str, Any] = field(default_factory=dict)
    training: Mapping[str, Any] = field(default_factory=dict)


def write_controller(controller: StoredController, folder: Path) -> None:
    """Write a controller into a new folder, all or nothing.

    Args:
        controller: What to write.
        folder: Must not exist.

    Raises:
        ModelFolderError: The folder exists.
        LiftingError: The model holds a function, which no file can hold.
    """
    extra = {
        # Earlier releases do not know the units, which most models do not need.
        "planner": {name: value for name, value in asdict(controller.planner).items() if value != ()},
        "action_low": np.asarray(controller.action_low, np.float64).tolist(),
        "action_high": np.asarray(controller.action_high, np.float64).tolist(),
        "task": dict(controller.task),
        "training": dict(controller.training),
    }
    write_model_folder(controller.model, folder, extra)


def read_controller(
    folder: str | Path, changes: Mapping[str, Any] | None = None, root: Path | None = None
) -> StoredController:
    """Read what a controller is made of.

    Args:
        folder: Folder of an exported model, or of a finished training run.
        changes: Settings of `PlannerConfig` to use instead of the stored ones.
        root: Folder that links may not leave; None takes `folder`.

    Returns:
        Model, planner, limits and what they are for.

    Raises:
        ModelFolderError: The folder holds no model this release can read.
        TypeError: An unknown planner setting.
    """
    known = [field.name for field in fields(PlannerConfig)]
    unknown = ", ".join(name for name in changes or {} if name not in known)
    if unknown:
        raise TypeError(f"planner settings {unknown} are not known; choose from {', '.join(known)}")
    folder = Path(folder)
    root = root or folder
    if (folder / MODEL_FOLDER).is_dir():
        folder = folder / MODEL_FOLDER
    elif (folder / "metrics.csv").is_file() and not (folder / CONFIG_FILE).is_file():
        raise ModelFolderError(
            f"{folder}: this training run is not finished, it has no model yet; continue it with "
            f"deepkoco train resume={folder}"
        )
    model, config = read_model_folder(folder, root)
    try:
        planner = _planner(config["planner"])
        low, high = (_limits(config[name], name, model.action_size) for name in ("action_low", "action_high"))
        if (low > high).any():
            raise ValueError("action_low is above action_high")
        samples = planner.samples * planner.sample_iterations if planner.method == "cem" else 1
        planned = planner.horizon * model.action_size
        if planned > MOST_PLANNED or samples * planned > MOST_SAMPLED:
            raise ValueError(
                f"planner.horizon = {planner.horizon} with {samples} samples is too much to plan in one step"
            )
    except KeyError as error:
        raise ModelFolderError(f"{folder}: entry {error} of {CONFIG_FILE} is missing") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise ModelFolderError(
            f"{folder}: {CONFIG_FILE} holds no planner of this release: {error}"
        ) from error
    # The first version of the format kept the seed and the number of episodes among the other entries.
    older = {name: config[name] for name in ("seed", "episodes") if name in config}
    return StoredController(
        model,
        replace(planner, **(changes or {})),
        low,
        high,
        _entries(config.get("task", {})),
        _entries(config.get("training", older)),
    )


def _planner(stored: Mapping[str, Any]) -> PlannerConfig:
    """Settings of the planner, each of the type of its field."""
    checks = {
        "int": lambda value, name: whole_number(value, name, 0),
        "float": lambda value, name: number_above(value, name, 0.0, equal=True),
        "str": text,
        "tuple[float, ...]": lambda value, name: tuple(number_above(entry, name, 0.0) for entry in value),
    }
    types = {field.name: str(field.type) for field in fields(PlannerConfig)}
    unknown = sorted(set(stored) - set(types))
    if unknown:
        raise ValueError(f"planner.{unknown[0][:50]} is unknown")
    planner = PlannerConfig(**{k: checks[types[k]](v, f"planner.{k}") for k, v in stored.items()})
    planner.check()
    return planner


def _limits(stored: Any, name: str, count: int) -> Array:
    """One number per action, none of which a solver takes as infinite."""
    if not isinstance(stored, list) or len(stored) != count:
        raise ValueError(f"{name} should hold {count} limits")
    limits = np.array([number_above(value, name, -np.inf) for value in stored])
    if (np.abs(limits) >= LARGEST_LIMIT).any():
        raise ValueError(f"{name} should hold limits below {LARGEST_LIMIT:g}")
    return limits


def _entries(stored: Any) -> dict[str, Any]:
    return stored if isinstance(stored, dict) else {}

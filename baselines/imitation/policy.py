"""A trained student in a batch of environments, and its folder: weights as safetensors, the rest as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.imitation.config import ImitationConfig
from baselines.imitation.ensemble import Ensemble
from baselines.model_files import settings_of
from baselines.policy import Array
from deepkoco.agent.stored_controller import MODEL_FOLDER
from deepkoco.koopman.files.folder_files import CONFIG_FILE, ModelFolderError, read_files, write_files

KIND = "imitation"


class ImitationPolicy:
    """Acts in B environments at once, and asks nobody: the mean of the members, in the step that was observed."""

    failures = 0
    """Decisions that could not be made: none."""

    def __init__(self, ensemble: Ensemble) -> None:
        """Set up.

        Args:
            ensemble: The student.
        """
        self.ensemble = ensemble

    def reset(self) -> None:
        """Start new episodes; nothing is remembered."""

    def act(self, observations: NDArray) -> Array:
        """Actions of this step.

        Args:
            observations: o_k (B, N).

        Returns:
            a_k (B, M), in the environment's units.
        """
        return self.ensemble.decide(torch.as_tensor(np.asarray(observations)))[0].numpy()


def write_policy(
    folder: Path,
    config: ImitationConfig,
    ensemble: Ensemble,
    task: Mapping[str, Any],
    training: Mapping[str, Any],
) -> None:
    """Write a trained student into a new folder, all or nothing.

    Args:
        folder: Must not exist.
        config: Settings.
        ensemble: What to write.
        task: What it controls.
        training: Where it comes from: seed, episodes, questions, package.

    Raises:
        ModelFolderError: The folder exists.
    """
    lines = "\n".join(f"| {name} | {value} |" for name, value in {**task, **training}.items())
    stored = {
        "kind": KIND,
        "settings": asdict(config),
        "observations": len(ensemble.observed.moments.mean),
        "action_low": ensemble.low.tolist(),
        "action_high": (ensemble.low + 2 * ensemble.half_range).tolist(),
        "task": dict(task),
        "training": dict(training),
    }
    card = (
        f"# {KIND}\n\nA policy that learned from answers. Load it with "
        f"`baselines.imitation.policy.load_policy(folder, count)`.\n\n| | |\n|---|---|\n{lines}\n"
    )
    arrays = {name: tensor.numpy() for name, tensor in ensemble.state_dict().items()}
    write_files(folder, stored, arrays, card)


def make_ensemble(size: int, low: Array, high: Array, config: ImitationConfig) -> Ensemble:
    """The networks that some settings ask for, with weights drawn from torch's generator.

    Args:
        size: N.
        low: a_min (M,).
        high: a_max (M,).
        config: Sizes.
    """
    return Ensemble(size, low, high, config.members, config.hidden, config.observation_limit)


def read_ensemble(folder: Path) -> tuple[ImitationConfig, Ensemble]:
    """Read a trained student; nothing in the folder is run.

    Args:
        folder: Folder of a finished run, or of its model.

    Returns:
        Settings, and networks with the weights and moments they were written with.

    Raises:
        ModelFolderError: The folder holds no student this release can read.
    """
    root = folder
    if (folder / MODEL_FOLDER).is_dir():
        folder = folder / MODEL_FOLDER
    config, arrays = read_files(folder, root)
    if config.get("kind") != KIND:
        raise ModelFolderError(f"{folder / CONFIG_FILE}: kind {str(config.get('kind'))[:50]!r}, not {KIND!r}")
    try:
        settings = settings_of(ImitationConfig, config["settings"])
        low, high = (np.array(config[name], np.float64) for name in ("action_low", "action_high"))
        ensemble = make_ensemble(int(config["observations"]), low, high, settings)
        ensemble.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
    except KeyError as error:
        raise ModelFolderError(f"{folder}: damaged, entry {error} is missing") from error
    except (TypeError, ValueError, RuntimeError) as error:
        raise ModelFolderError(f"{folder}: damaged, {' '.join(str(error).split())[:200]}") from error
    return settings, ensemble.requires_grad_(False)


def load_policy(folder: str | Path, count: int) -> ImitationPolicy:
    """Load a trained student.

    Args:
        folder: Folder of a finished run, or of its model.
        count: B; any, for the policy keeps nothing that depends on it.

    Returns:
        The controller.

    Raises:
        ModelFolderError: The folder holds no student this release can read.
    """
    return ImitationPolicy(read_ensemble(Path(folder))[1])

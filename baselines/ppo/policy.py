"""A trained PPO in a batch of environments, and its folder: weights and moments as safetensors, the rest as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.model_files import settings_of
from baselines.policy import Array
from baselines.ppo.config import PpoConfig
from baselines.ppo.networks import ActorCritic
from deepkoco.agent.stored_controller import MODEL_FOLDER
from deepkoco.koopman.files.folder_files import CONFIG_FILE, ModelFolderError, read_files, write_files

KIND = "ppo"


class PpoPolicy:
    """Acts without exploration in B environments at once: mu, clipped, in the step in which it was observed."""

    failures = 0
    """Decisions that could not be made: none."""

    def __init__(self, networks: ActorCritic) -> None:
        """Set up.

        Args:
            networks: The actor and the moments of its observations.
        """
        self.networks = networks

    def reset(self) -> None:
        """Start new episodes; nothing is remembered."""

    @torch.no_grad()
    def act(self, observations: NDArray) -> Array:
        """Actions of this step.

        Args:
            observations: o_k (B, N).

        Returns:
            a_k (B, M), in the environment's units.
        """
        networks = self.networks
        # In doubles where the environment has them, as in training: moments are taken off before single precision.
        seen = networks.observed(torch.as_tensor(np.asarray(observations)))
        return networks.to_environment(networks.actor(seen)).numpy()


def write_policy(
    folder: Path,
    config: PpoConfig,
    networks: ActorCritic,
    task: Mapping[str, Any],
    training: Mapping[str, Any],
) -> None:
    """Write trained networks into a new folder, all or nothing.

    Args:
        folder: Must not exist.
        config: Hyper-parameters.
        networks: What to write.
        task: What they control.
        training: Where they come from: seed, episodes, updates, package.

    Raises:
        ModelFolderError: The folder exists.
    """
    lines = "\n".join(f"| {name} | {value} |" for name, value in {**task, **training}.items())
    stored = {
        "kind": KIND,
        "settings": asdict(config),
        "observations": len(networks.observed.moments.mean),
        "action_low": networks.low.tolist(),
        "action_high": (networks.low + 2 * networks.half_range).tolist(),
        "task": dict(task),
        "training": dict(training),
    }
    card = (
        f"# {KIND}\n\nA policy that acts on states. Load it with `baselines.ppo.policy.load_policy(folder, count)`.\n\n"
        f"| | |\n|---|---|\n{lines}\n"
    )
    arrays = {name: tensor.numpy() for name, tensor in networks.state_dict().items()}
    write_files(folder, stored, arrays, card)


def read_networks(folder: Path) -> tuple[PpoConfig, ActorCritic]:
    """Read trained networks; nothing in the folder is run.

    Args:
        folder: Folder of a finished run, or of its model.

    Returns:
        Settings, and networks with the weights and moments they were written with.

    Raises:
        ModelFolderError: The folder holds no PPO this release can read.
    """
    root = folder
    if (folder / MODEL_FOLDER).is_dir():
        folder = folder / MODEL_FOLDER
    config, arrays = read_files(folder, root)
    if config.get("kind") != KIND:
        raise ModelFolderError(f"{folder / CONFIG_FILE}: kind {str(config.get('kind'))[:50]!r}, not {KIND!r}")
    try:
        settings = settings_of(PpoConfig, config["settings"])
        low, high = (np.array(config[name], np.float64) for name in ("action_low", "action_high"))
        networks = ActorCritic(int(config["observations"]), low, high, settings)
        networks.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
    except KeyError as error:
        raise ModelFolderError(f"{folder}: damaged, entry {error} is missing") from error
    except (TypeError, ValueError, RuntimeError) as error:
        raise ModelFolderError(f"{folder}: damaged, {' '.join(str(error).split())[:200]}") from error
    return settings, networks.requires_grad_(False)


def load_policy(folder: str | Path, count: int) -> PpoPolicy:
    """Load a trained PPO.

    Args:
        folder: Folder of a finished run, or of its model.
        count: B; any, for the policy keeps nothing that depends on it.

    Returns:
        The controller.

    Raises:
        ModelFolderError: The folder holds no PPO this release can read.
    """
    return PpoPolicy(read_networks(Path(folder))[1])

"""The folder of a trained baseline: weights as safetensors, everything else as JSON, with checksums."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.actor import Actor
from baselines.config import BaselineConfig
from baselines.critic import Critic
from baselines.registry import BASELINES, baseline, make_networks
from deepkoco.agent.stored_controller import MODEL_FOLDER
from deepkoco.koopman.files.folder_files import CONFIG_FILE, ModelFolderError, read_files, write_files

Array = NDArray[np.float64]


class CheckedSettings(Protocol):
    """A dataclass of settings."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def check(self) -> None:
        """Raise an error if a value is out of range."""


Settings = TypeVar("Settings", bound=CheckedSettings)


@dataclass(frozen=True)
class StoredNetworks:
    """Actor and critics of a trained baseline.

    Attributes:
        config: Hyper-parameters.
        actor: Its actor.
        critic: Its critics and encoder.
        shape: (N,) of states or (H, W, 3) of frames.
        low: a_min (M,).
        high: a_max (M,).
    """

    config: BaselineConfig
    actor: Actor
    critic: Critic
    shape: tuple[int, ...]
    low: Array
    high: Array


def write_networks(
    stored: StoredNetworks, folder: Path, task: Mapping[str, Any], training: Mapping[str, Any]
) -> None:
    """Write a trained baseline into a new folder, all or nothing.

    Args:
        stored: What to write.
        folder: Must not exist.
        task: What it controls.
        training: Where it comes from: seed, episodes, updates, package.

    Raises:
        ModelFolderError: The folder exists.
    """
    config = {
        "kind": stored.config.name,
        "settings": asdict(stored.config),
        "observation_shape": list(stored.shape),
        "action_low": stored.low.tolist(),
        "action_high": stored.high.tolist(),
        "task": dict(task),
        "training": dict(training),
    }
    arrays = {
        f"{part}.{name}": tensor.numpy()
        for part, module in (("actor", stored.actor), ("critic", stored.critic))
        for name, tensor in module.state_dict().items()
    }
    write_files(folder, config, arrays, _card(stored, task, training))


def read_networks(folder: Path) -> StoredNetworks:
    """Read a trained baseline; nothing in the folder is run.

    Args:
        folder: Folder of a finished run, or of its model.

    Returns:
        Networks with the weights they were written with.

    Raises:
        ModelFolderError: The folder holds no baseline this release can read.
    """
    root = folder
    if (folder / MODEL_FOLDER).is_dir():
        folder = folder / MODEL_FOLDER
    config, arrays = read_files(folder, root)
    if config.get("kind") not in BASELINES:
        raise ModelFolderError(
            f"{folder / CONFIG_FILE}: kind {str(config.get('kind'))[:50]!r}; "
            f"the baselines are {', '.join(BASELINES)}"
        )
    try:
        settings = settings_of(baseline(config["kind"]).settings, config["settings"])
        shape = tuple(int(side) for side in config["observation_shape"])
        low, high = (np.array(config[name], np.float64) for name in ("action_low", "action_high"))
        actor, critic = make_networks(shape, low.size, settings)
        for part, module in (("actor", actor), ("critic", critic)):
            own = {
                n.removeprefix(f"{part}."): torch.from_numpy(a)
                for n, a in arrays.items()
                if n.startswith(part)
            }
            module.load_state_dict(own)
            module.requires_grad_(False)
    except KeyError as error:
        raise ModelFolderError(f"{folder}: damaged, entry {error} is missing") from error
    except (TypeError, ValueError, RuntimeError) as error:
        raise ModelFolderError(f"{folder}: damaged, {' '.join(str(error).split())[:200]}") from error
    return StoredNetworks(settings, actor, critic, shape, low, high)


def settings_of(kind: type[Settings], stored: Mapping[str, Any]) -> Settings:
    """Settings of a class, lists as the tuples they were.

    Raises:
        ValueError: A name is unknown or a value out of range.
    """
    known = {field.name for field in fields(kind)}
    unknown = sorted(set(stored) - known)
    if unknown:
        raise ValueError(f"setting {unknown[0][:50]!r} is unknown")
    values: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in stored.items()}
    settings = kind(**values)
    settings.check()
    return settings


def _card(stored: StoredNetworks, task: Mapping[str, Any], training: Mapping[str, Any]) -> str:
    seen: Sequence[int] = stored.shape
    observed = (
        f"{seen[0]} states" if len(seen) == 1 else f"the newest {stored.config.frames} frames {tuple(seen)}"
    )
    facts = {**task, **training}
    lines = "\n".join(f"| {name} | {value} |" for name, value in facts.items())
    return (
        f"# {stored.config.name}\n\n"
        f"A baseline that acts on {observed}. Load it with `baselines.policy.load_policy(folder, count)`.\n\n"
        f"| | |\n|---|---|\n{lines}\n"
    )

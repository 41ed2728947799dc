"""The folder of a latent model: weights as safetensors, everything else as JSON, a card to read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepkoco.koopman.exported import ExportedModel
from deepkoco.koopman.files.folder_files import (
    CARD_FILE,
    CONFIG_FILE,
    WEIGHTS_FILE,
    Array,
    ModelFolderError,
    read_files,
    write_files,
)
from deepkoco.koopman.files.lifted_arrays import lifted_parts, read_lifted
from deepkoco.koopman.files.model_card import model_card
from deepkoco.koopman.files.network_arrays import network_parts, read_network
from deepkoco.koopman.latent_model import LatentModel
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel

__all__ = [
    "CARD_FILE",
    "CONFIG_FILE",
    "WEIGHTS_FILE",
    "ModelFolderError",
    "read_model_folder",
    "write_model_folder",
]

Parts = tuple[dict[str, Any], dict[str, Array]]


@dataclass(frozen=True)
class ModelKind:
    """How one kind of model is taken apart and put together.

    Attributes:
        model: Its class.
        parts: From the model to settings and arrays.
        read: From settings and arrays to the model; raises KeyError, TypeError or ValueError.
    """

    model: type
    parts: Callable[[Any], Parts]
    read: Callable[[Mapping[str, Any], Mapping[str, Array]], LatentModel]


KINDS = {
    "network": ModelKind(ExportedModel, network_parts, read_network),
    "lifted_linear": ModelKind(LiftedLinearModel, lifted_parts, read_lifted),
}


def write_model_folder(model: LatentModel, folder: Path, extra: dict[str, Any]) -> None:
    """Write a model into a new folder, all or nothing.

    Args:
        model: A model of one of `KINDS`.
        folder: Must not exist.
        extra: Further entries of config.json: the planner's settings, the action limits, task and training.

    Raises:
        ModelFolderError: The folder exists, or the model is of no such kind.
        LiftingError: The model holds a function, which no file can hold.
    """
    kind = next((name for name, kind in KINDS.items() if isinstance(model, kind.model)), None)
    if kind is None:
        raise ModelFolderError(
            f"{folder}: a {type(model).__name__} cannot be written; the kinds are {', '.join(KINDS)}"
        )
    settings, arrays = KINDS[kind].parts(model)
    config = {"kind": kind, **settings, **extra}
    write_files(folder, config, arrays, model_card(config))


def read_model_folder(folder: Path, root: Path | None = None) -> tuple[LatentModel, dict[str, Any]]:
    """Read a model.

    Args:
        folder: Folder written by `write_model_folder`.
        root: Folder that links may not leave; None takes `folder`.

    Returns:
        The model and the whole of config.json but the checksums.

    Raises:
        ModelFolderError: A file is missing, damaged, or was written by another format or version.
    """
    config, arrays = read_files(folder, root)
    path = folder / CONFIG_FILE
    kind = "network" if config["version"] == 1 else config.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ModelFolderError(f"{path}: kind {str(kind)[:50]!r}; this release reads {', '.join(KINDS)}")
    try:
        model = KINDS[kind].read(config, arrays)
    except KeyError as error:
        raise ModelFolderError(f"{folder}: damaged, entry {error} is missing") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ModelFolderError(f"{folder}: damaged, {error}") from error
    unknown = sorted(set(arrays) - set(KINDS[kind].parts(model)[1]))
    if unknown:
        raise ModelFolderError(f"{folder / WEIGHTS_FILE}: damaged, {unknown[0][:100]!r} belongs to no part")
    return model, config

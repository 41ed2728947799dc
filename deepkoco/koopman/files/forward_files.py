"""The folder of a forward model: the files of a model's folder with another kind."""

from __future__ import annotations

from pathlib import Path

from deepkoco.koopman.files.folder_files import (
    CONFIG_FILE,
    ModelFolderError,
    read_files,
    write_files,
)
from deepkoco.koopman.files.stored_values import number_above, whole_number
from deepkoco.koopman.forward_model import ForwardModel

KIND = "forward"
MOST_LAYERS = 100
CARD = """\
# Forward model

The next observation from this one and the action, as a tanh network: `deepkoco.koopman.forward_model.ForwardModel`.
A policy bridges delays with it.
"""


def write_forward_model(model: ForwardModel, folder: Path, errors: tuple[float, ...] = ()) -> None:
    """Write a forward model into a new folder, all or nothing.

    Args:
        model: The model.
        folder: Must not exist.
        errors: Relative errors on episodes held out, by number of steps, to be kept with it.

    Raises:
        ModelFolderError: The folder exists.
    """
    arrays = {}
    for i, (weight, bias) in enumerate(model.layers):
        arrays[f"layers.{i}.weight"], arrays[f"layers.{i}.bias"] = weight, bias
    config = {
        "kind": KIND,
        "time_step": model.time_step,
        "layers": len(model.layers),
        "errors": [float(error) for error in errors],
    }
    write_files(folder, config, arrays, CARD)


def read_forward_model(folder: Path) -> ForwardModel:
    """Read a forward model; nothing in its files is run.

    Args:
        folder: As written by `write_forward_model`.

    Raises:
        ModelFolderError: A file is missing or damaged, or the folder holds something else.
    """
    config, arrays = read_files(folder)
    if config.get("kind") != KIND:
        raise ModelFolderError(f"{folder / CONFIG_FILE}: kind {str(config.get('kind'))[:50]!r}, not {KIND!r}")
    try:
        count = whole_number(config["layers"], "layers", 1)
        if count > MOST_LAYERS:
            raise ValueError(f"layers = {count}; at most {MOST_LAYERS} are read")
        layers = tuple((arrays[f"layers.{i}.weight"], arrays[f"layers.{i}.bias"]) for i in range(count))
        model = ForwardModel(layers, number_above(config["time_step"], "time_step", 0.0))
    except KeyError as error:
        raise ModelFolderError(f"{folder}: damaged, entry {error} is missing") from error
    except (TypeError, ValueError) as error:
        raise ModelFolderError(f"{folder}: damaged, {error}") from error
    size = layers[0][0].shape[-1] if layers[0][0].ndim == 2 else 0
    for i, (weight, bias) in enumerate(layers):
        if bias.ndim != 1 or bias.size == 0 or weight.shape != (bias.size, size):
            raise ModelFolderError(f"{folder}: damaged, layers.{i}.weight has shape {weight.shape}")
        size = bias.size
    if model.action_size < 1:
        raise ModelFolderError(f"{folder}: damaged, the first layer takes no action")
    return model

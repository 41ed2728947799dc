"""The folder of an exported model: weights as safetensors, everything else as JSON."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.frame_arrays import frame_arrays, frame_settings, read_frame_encoder

FORMAT_VERSION = 1
WEIGHTS_FILE = "model.safetensors"
CONFIG_FILE = "config.json"


class ModelFolderError(ValueError):
    """A folder does not hold a readable exported model."""


def write_model_folder(model: ExportedModel, folder: Path, extra: dict[str, Any]) -> None:
    """Write `model.safetensors` and `config.json` into a new folder, all or nothing.

    Args:
        model: The model.
        folder: Must not exist.
        extra: Further entries of config.json (the planner's settings and the action limits).

    Raises:
        ModelFolderError: The folder exists.
    """
    if folder.exists():
        raise ModelFolderError(f"{folder}: exists already; choose another folder")
    arrays = {"mu": model.mu, "omega": model.omega}
    networks = {"encoder": model.encoder, "cost_factor": model.cost_factor}
    if model.decoder:
        networks["decoder"] = model.decoder
    for name, layers in networks.items():
        for i, (weight, bias) in enumerate(layers):
            arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"] = weight, bias
    config = {
        "format": "deepkoco-model",
        "version": FORMAT_VERSION,
        "time_step": model.time_step,
        "action_weight": model.action_weight,
        "action_size": model.action_size,
        "layers": {name: len(layers) for name, layers in networks.items()},
        **extra,
    }
    if model.frame_encoder is not None:
        arrays |= frame_arrays(model.frame_encoder)
        config["frame_encoder"] = frame_settings(model.frame_encoder)
    partial = folder.with_name(folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    save_file({k: np.ascontiguousarray(v) for k, v in arrays.items()}, partial / WEIGHTS_FILE)
    (partial / CONFIG_FILE).write_text(json.dumps(config, indent=2) + "\n")
    os.replace(partial, folder)


def read_model_folder(folder: Path) -> tuple[ExportedModel, dict[str, Any]]:
    """Read an exported model.

    Args:
        folder: Folder written by `write_model_folder`.

    Returns:
        The model and the whole of config.json.

    Raises:
        ModelFolderError: A file is missing, damaged, or was written by another format or version.
    """
    for name in (CONFIG_FILE, WEIGHTS_FILE):
        if not (folder / name).is_file():
            raise ModelFolderError(f"{folder}: no {name}; give the folder of an exported model")
    try:
        config = json.loads((folder / CONFIG_FILE).read_text(encoding="utf-8"))
    except ValueError as error:
        raise ModelFolderError(f"{folder / CONFIG_FILE}: damaged, it is not JSON: {error}") from error
    if not isinstance(config, dict):
        raise ModelFolderError(f"{folder / CONFIG_FILE}: damaged, it does not hold named entries")
    if config.get("format") != "deepkoco-model" or config.get("version") != FORMAT_VERSION:
        raise ModelFolderError(
            f"{folder / CONFIG_FILE}: format {config.get('format')!r} version {config.get('version')!r}; "
            f"this release reads 'deepkoco-model' version {FORMAT_VERSION}"
        )
    try:
        arrays = load_file(folder / WEIGHTS_FILE)
    except SafetensorError as error:
        raise ModelFolderError(f"{folder / WEIGHTS_FILE}: damaged: {error}") from error

    def layers(name: str) -> tuple[tuple[Array, Array], ...]:
        count = int(config["layers"][name] if name != "decoder" else config["layers"].get(name, 0))
        return tuple((arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"]) for i in range(count))

    try:
        model = ExportedModel(
            layers("encoder"),
            layers("cost_factor"),
            arrays["mu"],
            arrays["omega"],
            float(config["time_step"]),
            float(config["action_weight"]),
            int(config["action_size"]),
            layers("decoder"),
            read_frame_encoder(config["frame_encoder"], arrays) if "frame_encoder" in config else None,
        )
    except KeyError as error:
        raise ModelFolderError(f"{folder}: damaged, entry {error} is missing") from error
    except (TypeError, ValueError) as error:
        raise ModelFolderError(f"{folder / CONFIG_FILE}: damaged: {error}") from error
    _check_shapes(model, folder)
    return model, config


def _check_shapes(model: ExportedModel, folder: Path) -> None:
    """Check that the layers fit each other and the sizes."""
    latents = 2 * model.mu.size
    networks = [("encoder", model.encoder), ("cost_factor", model.cost_factor)]
    for name, layers in networks + ([("decoder", model.decoder)] if model.decoder else []):
        size = layers[0][0].shape[-1] if layers and name == "encoder" else latents
        for i, (weight, bias) in enumerate(layers):
            if weight.shape != (bias.size, size) or bias.ndim != 1:
                raise ModelFolderError(
                    f"{folder / WEIGHTS_FILE}: damaged, {name}.{i}.weight has shape {weight.shape}"
                )
            size = bias.size
        if name == "decoder":
            if size != model.observation_size:
                raise ModelFolderError(
                    f"{folder}: damaged, decoder does not end in the observation's entries"
                )
        elif not layers or size == 0 or (size % latents if name == "cost_factor" else size != latents):
            raise ModelFolderError(f"{folder}: damaged, {name} does not end in {latents} entries")
    frames = model.frame_encoder
    if frames is not None and model.observation_size != frames.frames * frames.features:
        raise ModelFolderError(
            f"{folder}: damaged, encoder does not take the features of {frames.frames} frames"
        )
    if model.omega.shape != model.mu.shape or not 1 <= model.action_size < model.encoder[0][0].shape[1]:
        raise ModelFolderError(f"{folder}: damaged, omega or action_size does not fit the other entries")

"""The trained model as named arrays and plain settings, as the folder of a model stores it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.files.frame_arrays import frame_arrays, frame_settings, read_frame_encoder
from deepkoco.koopman.files.stored_values import number_above, weights, weights_as_stored, whole_number

MOST_LAYERS = 100
Layers = tuple[tuple[Array, Array], ...]


def network_parts(model: ExportedModel) -> tuple[dict[str, Any], dict[str, Array]]:
    """Take a model apart.

    Args:
        model: The model.

    Returns:
        Settings for config.json, and `mu`, `omega` and `NETWORK.i.weight`, `NETWORK.i.bias` of layer i.
    """
    arrays = {"mu": model.mu, "omega": model.omega}
    networks = {"encoder": model.encoder, "cost_factor": model.cost_factor}
    if model.decoder:
        networks["decoder"] = model.decoder
    for name, layers in networks.items():
        for i, (weight, bias) in enumerate(layers):
            arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"] = weight, bias
    settings: dict[str, Any] = {
        "time_step": model.time_step,
        "action_weight": weights_as_stored(model.action_weight),
        "action_size": model.action_size,
        "layers": {name: len(layers) for name, layers in networks.items()},
    }
    if model.frame_encoder is not None:
        arrays |= frame_arrays(model.frame_encoder)
        settings["frame_encoder"] = frame_settings(model.frame_encoder)
    return settings, arrays


def read_network(settings: Mapping[str, Any], arrays: Mapping[str, Array]) -> ExportedModel:
    """Put a model together and check that its parts fit each other.

    Args:
        settings: At least its entries of config.json.
        arrays: At least its arrays.

    Returns:
        The model.

    Raises:
        KeyError: An entry or an array is missing.
        TypeError: An entry is of the wrong kind.
        ValueError: Parts do not fit each other; the message names the first that does not.
    """
    counts = settings["layers"]

    def layers(name: str, least: int = 1) -> Layers:
        count = whole_number(counts[name] if least else counts.get(name, 0), f"layers.{name}", least)
        if count > MOST_LAYERS:
            raise ValueError(f"layers.{name} = {count}; at most {MOST_LAYERS} are read")
        return tuple((arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"]) for i in range(count))

    model = ExportedModel(
        layers("encoder"),
        layers("cost_factor"),
        arrays["mu"],
        arrays["omega"],
        number_above(settings["time_step"], "time_step", 0.0),
        weights(settings["action_weight"], "action_weight"),
        whole_number(settings["action_size"], "action_size", 1),
        layers("decoder", 0),
        read_frame_encoder(settings["frame_encoder"], arrays) if "frame_encoder" in settings else None,
    )
    _check_shapes(model)
    return model


def _check_shapes(model: ExportedModel) -> None:
    """Check that the layers fit each other and the sizes."""
    if model.mu.ndim != 1 or model.mu.size == 0 or model.omega.shape != model.mu.shape:
        raise ValueError(f"mu has shape {model.mu.shape} and omega {model.omega.shape}")
    latents = 2 * model.mu.size
    networks = [("encoder", model.encoder), ("cost_factor", model.cost_factor)]
    for name, layers in networks + ([("decoder", model.decoder)] if model.decoder else []):
        size = layers[0][0].shape[-1] if layers[0][0].ndim == 2 and name == "encoder" else latents
        for i, (weight, bias) in enumerate(layers):
            if bias.ndim != 1 or bias.size == 0 or weight.shape != (bias.size, size):
                raise ValueError(f"{name}.{i}.weight has shape {weight.shape}")
            size = bias.size
        if name == "encoder" and not 1 <= model.action_size < layers[0][0].shape[1]:
            raise ValueError(f"action_size = {model.action_size} does not fit the encoder's inputs")
        if np.shape(model.action_weight) not in ((), (model.action_size,)):
            raise ValueError(f"action_weight has shape {np.shape(model.action_weight)}")
        ends = {"encoder": latents, "cost_factor": size - size % latents, "decoder": model.observation_size}
        if size == 0 or size != ends[name]:
            kind = {"encoder": f"{latents}", "cost_factor": f"a multiple of {latents}"}
            raise ValueError(
                f"{name} ends in {size} entries and not in {kind.get(name, model.observation_size)}"
            )
    frames = model.frame_encoder
    if frames is not None and model.observation_size != frames.frames * frames.features:
        raise ValueError(f"encoder does not take the features of {frames.frames} frames")

"""A frame encoder as named arrays and plain settings, as the folder of a model stores it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from deepkoco.koopman.exported_frames import Array, Convolution, ExportedFrameEncoder
from deepkoco.koopman.files.stored_values import number_above, whole_number

NAME = "frame_encoder"
MOST_FRAMES = 1000
_COLOURS = 3


def frame_arrays(encoder: ExportedFrameEncoder) -> dict[str, Array]:
    """Arrays of a frame encoder by name.

    Args:
        encoder: The frame encoder.

    Returns:
        `frame_encoder.{i}.weight` and `.bias` of layer i: the convolutions (out, in, kernel, kernel), then
        the linear layer (F, values).
    """
    layers = [*encoder.convolutions, encoder.last]
    pairs = [(f"{NAME}.{i}", *layer) for i, layer in enumerate(layers)]
    return {f"{name}.weight": w for name, w, _ in pairs} | {f"{name}.bias": b for name, _, b in pairs}


def frame_settings(encoder: ExportedFrameEncoder) -> dict[str, Any]:
    """The entry `frame_encoder` of config.json.

    Args:
        encoder: The frame encoder.

    Returns:
        Shape of a frame, number d of frames, gain of the differences, geometry of the convolutions.
    """
    return {
        "frame_shape": list(encoder.frame_shape),
        "frames": encoder.frames,
        "difference_gain": encoder.difference_gain,
        "convolutions": [asdict(geometry) for geometry in encoder.geometry],
    }


def read_frame_encoder(settings: Any, arrays: Mapping[str, Array]) -> ExportedFrameEncoder:
    """Put a frame encoder together and check that its layers fit each other.

    Args:
        settings: The entry `frame_encoder` of config.json.
        arrays: At least its arrays.

    Returns:
        The frame encoder.

    Raises:
        KeyError: An entry or an array is missing.
        TypeError: An entry is of the wrong kind.
        ValueError: The entries do not fit each other; the message names the first that does not.
    """
    shape = tuple(whole_number(number, f"{NAME}.frame_shape", 1) for number in settings["frame_shape"])
    frames = whole_number(settings["frames"], f"{NAME}.frames", 1)
    geometry = tuple(_read_convolution(entry) for entry in settings["convolutions"])
    if len(shape) != 3 or shape[2] != _COLOURS or not geometry or frames > MOST_FRAMES:
        raise ValueError(f"{NAME} takes no frames of shape {list(shape)} in stacks of {frames}")
    if geometry[0].padding:
        raise ValueError(f"{NAME}.convolutions.0.padding = {geometry[0].padding}; it should be 0")
    layers = [(arrays[f"{NAME}.{i}.weight"], arrays[f"{NAME}.{i}.bias"]) for i in range(len(geometry) + 1)]
    height, width, channels = shape
    for i, (convolution, (weight, bias)) in enumerate(zip(geometry, layers, strict=False)):
        side = convolution.kernel
        if bias.ndim != 1 or weight.shape != (bias.size, channels, side, side):
            raise ValueError(f"{NAME}.{i}.weight has shape {weight.shape}")
        height, width, channels = convolution.size(height), convolution.size(width), bias.size
        if min(height, width, channels) < 1:
            raise ValueError(f"{NAME}.{i} leaves nothing of a frame")
    weight, bias = layers[-1]
    if bias.ndim != 1 or bias.size < 1 or weight.shape != (bias.size, height * width * channels):
        raise ValueError(f"{NAME}.{len(geometry)}.weight has shape {weight.shape}")
    gain = number_above(settings["difference_gain"], f"{NAME}.difference_gain", 0.0)
    return ExportedFrameEncoder(shape, frames, geometry, tuple(layers[:-1]), layers[-1], gain)


def _read_convolution(entry: Any) -> Convolution:
    """Geometry of a layer; padding as wide as the kernel would only cost memory."""
    least = {"kernel": 1, "stride": 1, "padding": 0}
    values = {name: whole_number(entry[name], f"{NAME}.{name}", bound) for name, bound in least.items()}
    if values["padding"] >= values["kernel"]:
        raise ValueError(f"{NAME}.padding = {values['padding']}; it should be below the kernel's side")
    return Convolution(**values)

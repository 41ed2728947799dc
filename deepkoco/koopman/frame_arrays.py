"""A frame encoder as named arrays and plain settings, as the folder of a model stores it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from deepkoco.koopman.exported_frames import Array, Convolution, ExportedFrameEncoder

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
    shape = tuple(_whole(number, 1) for number in settings["frame_shape"])
    frames = _whole(settings["frames"], 1)
    geometry = tuple(
        Convolution(_whole(c["kernel"], 1), _whole(c["stride"], 1), _whole(c["padding"], 0))
        for c in settings["convolutions"]
    )
    if len(shape) != 3 or shape[2] != _COLOURS or not geometry or geometry[0].padding or frames > MOST_FRAMES:
        raise ValueError(f"{NAME} takes no frames of shape {list(shape)} in stacks of {frames}")
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
    gain = float(settings["difference_gain"])
    if not math.isfinite(gain):
        raise ValueError(f"{NAME} has the difference_gain {gain}")
    return ExportedFrameEncoder(shape, frames, geometry, tuple(layers[:-1]), layers[-1], gain)


def _whole(number: Any, least: int) -> int:
    if type(number) is not int or number < least:
        raise ValueError(f"{NAME} holds {number!r} in the place of a whole number of at least {least}")
    return number

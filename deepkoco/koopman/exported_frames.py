"""The frame encoder as plain NumPy arrays, and the history of features that a controller keeps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True)
class Convolution:
    """Geometry of a square convolution.

    Attributes:
        kernel: Side of the kernel.
        stride: Step between two places of the kernel.
        padding: Zeros around the input.
    """

    kernel: int
    stride: int
    padding: int

    def size(self, side: int) -> int:
        """Side of the output for an input of the given side."""
        return (side + 2 * self.padding - self.kernel) // self.stride + 1


DIFFERENCE_GAIN = 3.0
"""Weight of the differences between features of successive frames, which are small in one step of control."""
FIRST_CONVOLUTION = Convolution(4, 4, 0)
LATER_CONVOLUTIONS = Convolution(3, 2, 1)


@dataclass(frozen=True)
class ExportedFrameEncoder:
    """Features of frames with NumPy only, in single precision: a frame has 8 bits.

    Attributes:
        frame_shape: (height, width, colours) of a uint8 frame.
        frames: d, frames of one observation.
        geometry: Kernel, stride and padding of each convolution.
        convolutions: Weight (out, in, kernel, kernel) and bias (out,) of each convolution.
        last: Weight (F, values) and bias (F,) of the linear layer; its inputs are in the order (height,
            width, channel).
        difference_gain: g, weight of the differences of features in an observation.
    """

    frame_shape: tuple[int, ...]
    frames: int
    geometry: tuple[Convolution, ...]
    convolutions: tuple[tuple[Array, Array], ...]
    last: tuple[Array, Array]
    difference_gain: float = DIFFERENCE_GAIN

    @property
    def features(self) -> int:
        """F, features per frame."""
        return self.last[1].size

    @cached_property
    def _matrices(self) -> list[tuple[Single, Single]]:
        """Weights (kernel^2 * in, out) and bias of every layer, the scale of the pixels in the first."""
        layers = [
            (weight.transpose(2, 3, 1, 0).reshape(-1, weight.shape[0]), bias)
            for weight, bias in self.convolutions
        ]
        weight, bias = layers[0]
        # Pixels are x / 255 - 1/2; the first layer has no padding, so both are part of its weights.
        layers[0] = (weight / 255.0, bias - 0.5 * weight.sum(0))
        layers.append((self.last[0].T, self.last[1]))
        return [
            (np.ascontiguousarray(weight, np.float32), np.ascontiguousarray(bias, np.float32))
            for weight, bias in layers
        ]

    def encode(self, frames: NDArray[np.uint8]) -> Array:
        """Features of frames.

        Args:
            frames: uint8 (..., H, W, 3).

        Returns:
            Features (..., F).
        """
        *convolutions, (last, bias) = self._matrices
        x = frames.reshape(-1, *self.frame_shape).astype(np.float32)  # (n, H, W, channels)
        for geometry, (weight, offset) in zip(self.geometry, convolutions, strict=True):
            x = _convolve(x, geometry, weight)
            x += offset
            np.maximum(x, 0.0, out=x)
        z = x.reshape(len(x), -1) @ last + bias
        return z.reshape(*frames.shape[:-3], -1).astype(np.float64)


def _convolve(x: Single, geometry: Convolution, weight: Single) -> Single:
    """Convolution of (n, H, W, channels) as one matrix product."""
    pad, kernel, stride = geometry.padding, geometry.kernel, geometry.stride
    if pad:
        count, height, width, channels = x.shape
        padded = np.zeros((count, height + 2 * pad, width + 2 * pad, channels), np.float32)
        padded[:, pad:-pad, pad:-pad] = x
        x = padded
    windows = sliding_window_view(x, (kernel, kernel), axis=(1, 2))[:, ::stride, ::stride]
    # Channels last: the copy then moves whole runs of them.
    patches = windows.transpose(0, 1, 2, 4, 5, 3)
    return patches.reshape(*patches.shape[:3], -1) @ weight


class FeatureHistory:
    """The features of the last d frames of one environment, or of a batch: an observation.

    A frame is encoded once, when it comes. Before the first frame of an episode there is only that frame.
    """

    def __init__(self, encoder: ExportedFrameEncoder) -> None:
        """Start without a frame.

        Args:
            encoder: Encodes the frames.
        """
        self._encoder = encoder
        self._features: list[Array] | None = None  # newest first

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """(height, width, colours) of a frame."""
        return self._encoder.frame_shape

    @property
    def observation_type(self) -> type[np.uint8]:
        """Type of a pixel."""
        return np.uint8

    def reset(self) -> None:
        """Forget all frames at the start of an episode."""
        self._features = None

    def push(self, frames: NDArray[np.uint8]) -> Array:
        """Take in the frame of this step.

        Args:
            frames: uint8 (..., H, W, 3).

        Returns:
            The observation (..., d F): z_k, then g (z_k - z_{k-1}), g (z_{k-1} - z_{k-2}) and so on.

        Source: DeepKoCo, Eq. 5.11; see `deepkoco.koopman.model.frame_encoder.stack_features`.
        """
        newest = self._encoder.encode(frames)
        if self._features is None:
            self._features = [newest] * self._encoder.frames
        else:
            self._features = [newest, *self._features[:-1]]
        gain = self._encoder.difference_gain
        differences = [gain * (after - before) for after, before in pairwise(self._features)]
        return np.concatenate([newest, *differences], axis=-1)

"""From video frames to features: one small convolutional network that sees each frame once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn

from deepkoco.koopman.exported_frames import (
    DIFFERENCE_GAIN,
    FIRST_CONVOLUTION,
    LATER_CONVOLUTIONS,
    Convolution,
)


class FrameShapeError(ValueError):
    """Frames are too small for the layers of the network."""


def layer_geometry(frame_shape: Sequence[int], channels: Sequence[int]) -> tuple[list[Convolution], int]:
    """Geometry of the layers.

    Args:
        frame_shape: (height, width, colours).
        channels: Output channels of each layer.

    Returns:
        Kernel, stride and padding of each layer, and the number of values that the last one gives.

    Raises:
        FrameShapeError: Nothing would be left of a frame.
    """
    layers = [FIRST_CONVOLUTION, *[LATER_CONVOLUTIONS] * (len(channels) - 1)]
    height, width = frame_shape[:2]
    for layer in layers:
        height, width = layer.size(height), layer.size(width)
    if min(height, width) < 1 or len(frame_shape) != 3:
        raise FrameShapeError(
            f"frames of shape {tuple(frame_shape)} do not fit {len(channels)} convolutions; "
            f"give frames of at least {FIRST_CONVOLUTION.kernel} x {FIRST_CONVOLUTION.kernel} pixels in colour"
        )
    return layers, height * width * channels[-1]


class FrameEncoder(nn.Module):
    r"""$z_k = f(\text{frame}_k) \in R^F$, computed once and used in all d observations the frame is part of.

    The first layer looks at patches of 4 x 4 pixels, which turns 12,288 numbers into a 16 x 16 map at once:
    nearly all the time of a network on 64 x 64 frames is spent in its first layers. Weights start as He et
    al. (2015) have them: with PyTorch's own, features of different frames differ by 0.001 at the start.

    Source: DeepKoCo, Eq. 5.11; the thesis cites a CNN ([132]) and lists no layers, so they are chosen here.
    """

    def __init__(self, frame_shape: Sequence[int], channels: Sequence[int], features: int) -> None:
        """Make the layers.

        Args:
            frame_shape: (height, width, colours) of a uint8 frame.
            channels: Output channels of each convolution.
            features: F, features per frame.

        Raises:
            FrameShapeError: The frames are too small.
        """
        super().__init__()
        self.frame_shape = tuple(frame_shape)
        self.geometry, values = layer_geometry(frame_shape, channels)
        pairs = zip(pairwise([frame_shape[2], *channels]), self.geometry, strict=True)
        convolutions = [nn.Conv2d(a, b, g.kernel, g.stride, g.padding) for (a, b), g in pairs]
        for layer in convolutions:
            # On one core less time than with the channels first in memory.
            layer.weight.data = layer.weight.data.contiguous(memory_format=torch.channels_last)
        self.layers = nn.ModuleList(convolutions)
        self.last = nn.Linear(values, features)
        for layer in (*convolutions, self.last):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            nn.init.zeros_(cast(Tensor, layer.bias))

    @property
    def convolutions(self) -> list[nn.Conv2d]:
        """The convolutions, first to last."""
        return cast(list[nn.Conv2d], list(self.layers))

    def forward(self, frames: Tensor) -> Tensor:
        """Features of frames.

        Args:
            frames: uint8 (..., H, W, 3).

        Returns:
            Features (..., F).
        """
        x = frames.flatten(0, -4).permute(0, 3, 1, 2)  # (n, 3, H, W), channels last in memory
        x = x.to(self.last.weight.dtype).div_(255.0).sub_(0.5)
        for layer in self.convolutions:
            x = torch.relu(layer(x))
        # In the order (height, width, channel), which is that of the memory: no copy.
        return self.last(x.permute(0, 2, 3, 1).flatten(1)).unflatten(0, frames.shape[:-3])


def stack_features(features: Tensor, frames: int) -> Tensor:
    r"""Observations $(z_k,\ g(z_k - z_{k-1}),\ g(z_{k-1} - z_{k-2}), \dots)$ of the features of d frames.

    That is the published stack $(z_{k-d+1}, \dots, z_k)$ times an invertible matrix. Velocities are in the
    differences, which the encoder would have to find as small differences of large weights otherwise.

    Args:
        features: (G, L + d - 1, F).
        frames: d.

    Returns:
        (G, L, d F).

    Source: DeepKoCo, Eq. 5.11, but for the differences and their gain g.
    """
    differences = DIFFERENCE_GAIN * features.diff(dim=1)
    steps = features.shape[1] - frames + 1
    newest = [features[:, frames - 1 :]]
    return torch.cat(newest + [differences[:, i : i + steps] for i in reversed(range(frames - 1))], dim=-1)

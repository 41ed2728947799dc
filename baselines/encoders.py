"""From observations to latents: a body, which actor and critics may share, and a head of each."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from baselines.config import BaselineConfig, BaselineConfigError

KERNEL = 3


def as_input(observations: Tensor) -> Tensor:
    """What a body takes.

    Args:
        observations: States (B, N), or uint8 stacks of frames (B, H, W, 3d).

    Returns:
        The states, or the frames (B, 3d, H, W) scaled to [0, 1], channels last in memory.
    """
    if observations.dtype != torch.uint8:
        return observations
    planes = observations.permute(0, 3, 1, 2)
    return planes.to(torch.float32, memory_format=torch.channels_last).div_(255.0)


class StateBody(nn.Sequential):
    """Fully connected layers with ReLU."""

    def __init__(self, size: int, hidden: Sequence[int]) -> None:
        """Make the layers.

        Args:
            size: N.
            hidden: Widths; none leaves the states as they are.
        """
        layers = [(nn.Linear(a, b), nn.ReLU(inplace=True)) for a, b in pairwise([size, *hidden])]
        super().__init__(*[layer for pair in layers for layer in pair])
        self.width = [size, *hidden][-1]


class PixelBody(nn.Module):
    """Convolutions of 3 x 3 with ReLU.

    Source: Yarats et al. (2021), Sec. 4: four of 32 channels, the first of stride 2.
    """

    def __init__(
        self, shape: Sequence[int], frames: int, channels: Sequence[int], strides: Sequence[int]
    ) -> None:
        """Make the layers.

        Args:
            shape: (H, W, 3) of a frame.
            frames: d.
            channels: Of each convolution.
            strides: Of each convolution.

        Raises:
            BaselineConfigError: Nothing is left of a frame.
        """
        super().__init__()
        self.sizes = [tuple(shape[:2])]
        for stride in strides:
            height, width = ((side - KERNEL) // stride + 1 for side in self.sizes[-1])
            if min(height, width) < 1:
                raise BaselineConfigError(
                    f"convolution_strides = {list(strides)}: nothing is left of frames of {shape[0]} x {shape[1]} "
                    "pixels; give fewer convolutions or smaller strides"
                )
            self.sizes.append((height, width))
        pairs = zip(pairwise([shape[2] * frames, *channels]), strides, strict=True)
        self.layers = nn.ModuleList([nn.Conv2d(a, b, KERNEL, s) for (a, b), s in pairs])
        self.width = channels[-1] * self.sizes[-1][0] * self.sizes[-1][1]

    def forward(self, observations: Tensor) -> Tensor:
        """Features (B, width) of frames (B, 3d, H, W)."""
        x = observations
        for layer in self.layers:
            x = torch.relu(layer(x))
        return x.permute(0, 2, 3, 1).flatten(1)  # in the order of the memory: no copy


def make_body(shape: Sequence[int], config: BaselineConfig) -> StateBody | PixelBody:
    """The body for observations of a shape.

    Args:
        shape: (N,) of states or (H, W, 3) of frames.
        config: Sizes.

    Returns:
        A network from `as_input` of observations to features (B, width).
    """
    if len(shape) == 1:
        return StateBody(shape[0], config.encoder_hidden)
    return PixelBody(shape, config.frames, config.convolution_channels, config.convolution_strides)


def make_head(width: int, features: int) -> nn.Sequential:
    """Linear layer with LayerNorm, from the features of a body to a latent (B, Z)."""
    return nn.Sequential(nn.Linear(width, features), nn.LayerNorm(features))

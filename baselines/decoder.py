"""From latents to frames: the encoder of frames backwards."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from baselines.encoders import KERNEL, PixelBody
from baselines.initialisation import initialise

COLOURS = 3
LEVELS = 32
"""Brightness levels of a target: five bits."""


class PixelDecoder(nn.Module):
    """Linear layer with ReLU, then transposed convolutions of 3 x 3 that undo those of a body.

    Source: Yarats et al. (2021), App. B.
    """

    def __init__(self, features: int, body: PixelBody) -> None:
        """Make the layers.

        Args:
            features: Z.
            body: The encoder's.
        """
        super().__init__()
        self._height, self._width = body.sizes[-1]
        convolutions = [layer for layer in body.layers if isinstance(layer, nn.Conv2d)]
        self.first = nn.Linear(features, body.width)
        layers = []
        for i in reversed(range(len(convolutions))):
            stride = convolutions[i].stride[0]
            channels = convolutions[i].in_channels if i else COLOURS
            # What a stride left over at the lower and right edge.
            missing = [
                wanted - ((side - 1) * stride + KERNEL)
                for wanted, side in zip(body.sizes[i], body.sizes[i + 1], strict=True)
            ]
            layers.append(
                nn.ConvTranspose2d(
                    convolutions[i].out_channels,
                    channels,
                    KERNEL,
                    stride,
                    output_padding=(missing[0], missing[1]),
                )
            )
        self.layers = nn.ModuleList(layers)
        self.apply(initialise)

    def forward(self, latents: Tensor) -> Tensor:
        """Frames (B, 3, H, W), in [-1/2, 1/2] as `decoder_target` gives them, of latents (B, Z)."""
        x = torch.relu(self.first(latents)).unflatten(1, (self._height, self._width, -1)).permute(0, 3, 1, 2)
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        return self.layers[-1](x)


def decoder_target(frames: Tensor, generator: torch.Generator) -> Tensor:
    """What the decoder is to give.

    Args:
        frames: The frames of an observation (B, 3d, H, W), in [0, 1].
        generator: Source of the dither.

    Returns:
        The oldest frame (B, 3, H, W) in 32 levels with uniform dither, in [-1/2, 1/2].
    """
    oldest = frames[:, :COLOURS]
    # The scale of a pixel is 255, so 255 / 8 levels are counted from below; half a grey value guards the rounding.
    levels = torch.floor((oldest * 255.0 + 0.5) / (256 // LEVELS))
    return (levels + torch.rand(levels.shape, generator=generator)) / LEVELS - 0.5

"""A loaded model as one torch function, for the exporters."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from deepkoco.koopman.exported import ExportedModel
from deepkoco.koopman.exported_frames import ExportedFrameEncoder


class LinearisedModel(nn.Module):
    """(observation, action) -> (latent, B, C) in double precision, batched.

    Observations are (batch, N); for a model on images they are the last d frames, oldest first, uint8
    (batch, d, H, W, 3).
    """

    def __init__(self, model: ExportedModel) -> None:
        """Take over the weights.

        Args:
            model: A trained model.
        """
        super().__init__()
        self._action_size, self._latents = model.action_size, 2 * model.mu.size
        self._encoder = self._keep("encoder", model.encoder)
        self._cost_factor = self._keep("cost_factor", model.cost_factor)
        self._frames = model.frame_encoder
        if self._frames is not None:
            self._convolutions = self._keep("convolution", self._frames.convolutions)
            self._keep("features", (self._frames.last,))

    def forward(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Linearise at a batch of points.

        Args:
            observation: (batch, N) or frames.
            action: (batch, M).

        Returns:
            Latent (batch, n), B (batch, n, M) and C (batch, r, n).
        """
        if self._frames is not None:
            observation = self._features(observation, self._frames)
        x = torch.cat((observation, action), -1)
        weight, bias = self._layer("encoder", 0)
        tangent = weight.T[-self._action_size :]
        x = functional.linear(x, weight, bias)
        for i in range(1, self._encoder):
            active = (x > 0).to(x.dtype).unsqueeze(-2)
            weight, bias = self._layer("encoder", i)
            tangent = (active * tangent) @ weight.T
            x = functional.linear(torch.relu(x), weight, bias)
        if self._encoder == 1:
            tangent = tangent.expand(x.shape[0], -1, -1)
        c = x
        for i in range(self._cost_factor):
            c = functional.linear(torch.relu(c) if i else c, *self._layer("cost_factor", i))
        return x, tangent.transpose(-1, -2), c.unflatten(-1, (-1, self._latents))

    def _features(self, frames: Tensor, encoder: ExportedFrameEncoder) -> Tensor:
        """The observation of a stack of frames; see `FeatureHistory.push`."""
        x = frames.flatten(0, 1).permute(0, 3, 1, 2).to(torch.float64) / 255.0 - 0.5
        for i, geometry in enumerate(encoder.geometry):
            weight, bias = self._layer("convolution", i)
            x = torch.relu(functional.conv2d(x, weight, bias, geometry.stride, geometry.padding))
        z = functional.linear(x.permute(0, 2, 3, 1).flatten(1), *self._layer("features", 0))
        z = z.unflatten(0, (-1, encoder.frames)).flip(1)  # newest first
        differences = encoder.difference_gain * (z[:, :-1] - z[:, 1:])
        return torch.cat((z[:, :1], differences), 1).flatten(1)

    def _keep(self, name: str, layers: tuple) -> int:
        for i, (weight, bias) in enumerate(layers):
            self.register_buffer(f"{name}_{i}_weight", torch.from_numpy(weight).to(torch.float64))
            self.register_buffer(f"{name}_{i}_bias", torch.from_numpy(bias).to(torch.float64))
        return len(layers)

    def _layer(self, name: str, i: int) -> tuple[Tensor, Tensor]:
        return self.get_buffer(f"{name}_{i}_weight"), self.get_buffer(f"{name}_{i}_bias")

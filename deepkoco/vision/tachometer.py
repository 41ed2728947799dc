"""A speed sensor at the motor: fast and at once, with a gain and a zero of its own."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.graph.model.noise import Noise


class Tachometer(Node):
    """Speed of the world's last state, (B, 1) [rad/s]: gain * speed + zero + noise.

    Parameters: ``tacho_gain`` (1) and ``tacho_zero`` [rad/s].

    Args:
        rate: Measurements per second [Hz].
        noise: Standard deviation [rad/s].
    """

    inputs = ("world",)

    def __init__(self, rate: float, noise: float = 0.05) -> None:
        super().__init__("tachometer", rate)
        self.noise = noise

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, 1, dtype=torch.float64)

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, noise: Noise
    ) -> tuple[State, Tensor]:
        gain = parameters.get("tacho_gain", _ONE)
        zero = parameters.get("tacho_zero", 0.0 * _ONE)
        shown = gain * inputs["world"].data[:, -1, 1] + zero + self.noise * noise.normal()
        return state, shown[:, None]


_ONE = torch.ones((), dtype=torch.float64)

"""How old the water at the end of a pipe is, from the flow through it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.fluids import swept_time


class FlowDelay(Node):
    """Counts back the measured flow until it has swept the volume of the pipe.

    Input ``sensor`` with a part ``flow``: the mean since its last message. Output (B, 1): the age of what the sensor
    shows [s], with a further constant age of the sensor itself.

    Args:
        rate: Of itself and of the sensor [Hz].
        volume: Of the pipe, as far as the controller knows it [m3].
        further: Constant age on top [s].
        longest: Longest time that is counted back [s].
        **options: As for `Node`.
    """

    inputs = ("sensor",)

    def __init__(self, rate: float, volume: float, further: float, longest: float, **options) -> None:
        super().__init__("delay", rate, **options)
        self.volume = torch.tensor(volume, dtype=torch.float64)
        self.further, self.slots = further, math.ceil(longest * rate)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"volumes": torch.zeros(batch, self.slots, dtype=torch.float64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.full((batch, 1), self.further, dtype=torch.float64)

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, Tensor]:
        volume = inputs["sensor"].data["flow"][:, -1] * dt
        volumes = torch.cat([volume[:, None], state["volumes"][:, :-1]], 1)
        age = swept_time(volumes, dt, parameters.get("pipe_volume", self.volume)) + self.further
        return {"volumes": volumes}, age[:, None]

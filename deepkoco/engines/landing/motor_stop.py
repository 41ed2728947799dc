"""The safety of a landing: what stands between agent and motors."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.landing import GROUND


class MotorStop(Node):
    """Hands commands on, and stops the motors for good after a touch-down or outside of the room.

    Inputs: ``command`` (B, 3) thrust [N], roll and pitch [rad]; ``touchdown``, a `Touchdown`. Output: a command (B, 3),
    whose thrust is 0 once it has stopped.

    Args:
        rate: Ticks per second [Hz].
        idle: Command (3,) before the first one.
        far: Distance from the deck along x and y beyond which it stops [m].
        high: Height over the centre of the deck beyond which it stops [m].
    """

    inputs = ("command", "touchdown")
    free_rate = True

    def __init__(self, rate: float, idle: Tensor, far: float, high: float) -> None:
        super().__init__("motor_stop", rate, phase=0)
        self.idle, self.far, self.high = idle, far, high

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"stopped": torch.zeros(batch, dtype=torch.bool)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return self.idle.expand(batch, len(self.idle)).clone()

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        shown, command = inputs["touchdown"].data, inputs["command"].data[:, -1]
        gone = outside(shown["way"][:, -1], self.far, self.high)
        stopped = state["stopped"] | (shown["touched"][:, -1] > 0.5) | gone
        thrust, roll, pitch = command.unbind(-1)
        return {"stopped": stopped}, torch.stack([torch.where(stopped, 0.0, thrust), roll, pitch], -1)


def outside(way: Tensor, far: float, high: float) -> Tensor:
    """Whether a body has left the room about the deck, or hit the ground (...) bool.

    Args:
        way: (..., 3) from the centre of the deck [m].
        far, high: As for `MotorStop`.
    """
    x, y, z = way.unbind(-1)
    return (torch.abs(x) > far) | (torch.abs(y) > far) | (z > high) | (z < GROUND)

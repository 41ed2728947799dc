"""What is measured while a box is pushed: the joints by encoders, the box by a camera."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.engines.boxpush.world import box_state
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State

TICK = 2.0 * math.pi / 4096
"""Of an encoder [rad]."""
SPEED_NOISE = 0.02  # of a joint's speed [rad/s]
CAMERA_NOISE = (0.001, 0.01)
"""Of the box's place along each axis [m], and of its turn [rad]."""


class Encoders(Node):
    """Angles (B, 6) of the joints in whole ticks [rad], their speeds (B, 6) [rad/s], and ``stamp`` (B,) [s], in parts.

    Before the first message a receiver sees the start, which the reset gives as ``start`` (B, 12).

    Args:
        rate: Measurements per second [Hz].
        noise: Angles are rounded and speeds have noise.
    """

    inputs = ("world",)
    outputs = {  # noqa: RUF012
        "angles": ((6,), torch.float64),
        "speeds": ((6,), torch.float64),
        "stamp": ((), torch.float64),
    }
    free_rate = True
    finite = False  # a world that has diverged says so

    def __init__(self, rate: float, noise: bool = True) -> None:
        super().__init__("encoders", rate)
        self.noise = noise

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"start": torch.zeros(batch, 12, dtype=torch.float64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        start = state["start"]
        return {"angles": start[:, :6], "speeds": start[:, 6:], "stamp": torch.zeros_like(start[:, 0])}

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, noise
    ) -> tuple[State, dict[str, Tensor]]:
        world = inputs["world"]
        seen = box_state(world.data[:, -1])
        stamp = world.t_start.clone()
        if not self.noise:
            return state, {"angles": seen.angles, "speeds": seen.speeds, "stamp": stamp}
        angles = TICK * torch.round(seen.angles / TICK)
        speeds = seen.speeds + SPEED_NOISE * noise.normal(6)
        return state, {"angles": angles, "speeds": speeds, "stamp": stamp}


class BoxCamera(Node):
    """Place along x and y [m] and turn [rad] of the box, ``box`` (B, 3), and ``stamp`` (B,), when it was seen [s].

    Before the first message a receiver sees the start, which the reset gives as ``start`` (B, 3).

    Args:
        rate: Pictures per second [Hz].
        noise_sd: Of the place [m] and the turn [rad].
    """

    inputs = ("world",)
    outputs = {"box": ((3,), torch.float64), "stamp": ((), torch.float64)}  # noqa: RUF012
    free_rate = True
    finite = False

    def __init__(self, rate: float, noise_sd: tuple[float, float] = CAMERA_NOISE) -> None:
        super().__init__("camera", rate)
        self.noise_sd = noise_sd

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"start": torch.zeros(batch, 3, dtype=torch.float64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return {"box": state["start"], "stamp": torch.zeros(batch, dtype=torch.float64)}

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, noise
    ) -> tuple[State, dict[str, Tensor]]:
        world = inputs["world"]
        seen = box_state(world.data[:, -1])
        clean = torch.cat([seen.place[:, :2], seen.yaw[:, None]], -1)
        place, turn = self.noise_sd
        spread = torch.tensor([place, place, turn], dtype=torch.float64)
        return state, {"box": clean + spread * noise.normal(3), "stamp": world.t_start.clone()}

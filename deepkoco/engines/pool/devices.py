"""What moves the water and heats it, and what measures it."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.graph import Delay, Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.fluids import pool_parameters

NOMINAL: Mapping[str, Mapping[str, Tensor]] = pool_parameters()


class Actuator(Node):
    """Delivers ``scale`` times the level of its command, after a lag of first order with the time constant ``lag`` [s].

    Input ``command`` (B, M), output (B, 1) what it delivers at the end of its tick.

    Args:
        name: "heater" or "pump": whose nominal parameters it has.
        rate: Ticks per second [Hz].
        entry: Which entry of a command is its own.
        low: Lowest level; the highest is 1.
        idle: Level before the first command.
    """

    inputs = ("command",)
    free_rate = True

    def __init__(self, name: str, rate: float, entry: int, low: float = 0.0, idle: float = 0.0) -> None:
        super().__init__(name, rate)
        self.entry, self.low, self.idle = entry, low, idle

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        scale = {**NOMINAL[self.name], **parameters}["scale"]
        return {"delivered": (self.idle * scale).expand(batch).clone()}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["delivered"][:, None]

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, Tensor]:
        own = {**NOMINAL[self.name], **parameters}
        level = inputs["command"].data[:, -1, self.entry].to(torch.float64).clamp(self.low, 1.0)
        moved = state["delivered"] + _share(own["lag"], dt) * (own["scale"] * level - state["delivered"])
        return {"delivered": moved}, moved[:, None]


class Probe(Node):
    """Thermometer and flow meter at the end of the pipe, both slow.

    The thermometer follows the water with the time constant ``lag`` [s] and has noise; the flow meter counts the
    volume between two of its messages, to a share of it.

    Output, in parts, (B,) each: ``temperature`` [deg C] and ``flow`` [m3/s], the mean since the last message.

    Args:
        rate: Messages per second [Hz].
        world_rate: Ticks of the world per second [Hz]; connect it with a window of `least_window`.
        noise_sd: Of the temperature [K].
        flow_noise: Standard deviation of the flow, as a share of it.
    """

    inputs = ("world",)
    outputs = {name: ((), torch.float64) for name in ("temperature", "flow")}  # noqa: RUF012

    def __init__(
        self, rate: float, world_rate: float, noise_sd: float = 0.05, flow_noise: float = 0.01
    ) -> None:
        super().__init__("probe", rate)
        self.noise_sd, self.flow_noise, self.tick = noise_sd, flow_noise, 1.0 / world_rate

    def least_window(self, delay: Delay, sender: Node) -> int:
        """The states of the world between two messages."""
        return max(round(float(sender.rate / self.rate)), 1)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {
            "temperature": torch.full((batch,), 28.0, dtype=torch.float64),
            "seen": torch.full((batch,), -1, dtype=torch.int64),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return {"temperature": state["temperature"], "flow": torch.zeros_like(state["temperature"])}

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, noise
    ) -> tuple[State, dict[str, Tensor]]:
        share = _share({**NOMINAL["probe"], **parameters}["lag"], self.tick)
        world, temperature, seen = inputs["world"], state["temperature"], state["seen"]
        volume, count = torch.zeros_like(temperature), torch.zeros_like(temperature)
        for k in range(world.seq.shape[1]):
            new = world.seq[:, k] > seen
            outlet, flow = world.data["outlet"][:, k], world.data["flow"][:, k]
            temperature = torch.where(new, temperature + share * (outlet - temperature), temperature)
            volume, count = volume + torch.where(new, flow, 0.0), count + torch.where(new, 1.0, 0.0)
        after = {"temperature": temperature, "seen": torch.maximum(seen, world.seq[:, -1])}
        flow = volume / count.clamp_min(1.0) * (1.0 + self.flow_noise * noise.normal())
        return after, {"temperature": temperature + self.noise_sd * noise.normal(), "flow": flow}


def _share(lag: Tensor, dt: float) -> Tensor:
    """Share of a step that a lag of first order has made after dt."""
    slow = lag > 0.0
    return torch.where(slow, 1.0 - torch.exp(-dt / torch.where(slow, lag, 1.0)), 1.0)

"""The sensor of a robot on a simulating engine."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.engines.noise import draw_keys, normal
from deepkoco.engines.start import start_state
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import Parameters, System


class Sensor(Node):
    """Measures the world's last state; the output is (B, N).

    Before the first message has come a receiver sees a measurement of the start state: the parameter
    ``start`` (B, S), or what the runtime's reset gives as ``initial``.

    Args:
        system: Declares the measurements.
        rate: Measurements per second [Hz].
        noise: Standard deviation of the noise per channel, in the channel's unit.
    """

    def __init__(self, system: System, rate: float, noise: tuple[float, ...]) -> None:
        super().__init__("sensor", rate)
        self.system, self.noise = system, noise
        self.noisy = any(spread > 0.0 for spread in noise)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        state = {"start": start_state(self.system, parameters, batch)}
        if self.noisy:
            state["key"] = draw_keys(batch, generator)
            state["tick"] = torch.zeros(batch, dtype=torch.int64)
        return state

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        clean = self.system.measure(state["start"], parameters)
        return clean + self._draw(state) if self.noisy else clean

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        clean = self.system.measure(inputs["world"].data[:, -1], parameters)
        if not self.noisy:
            return state, clean
        return {**state, "tick": state["tick"] + 1}, clean + self._draw(state)

    def _draw(self, state: State) -> Tensor:
        """Noise of this tick (B, N)."""
        draws = [
            spread * normal(state["key"], state["tick"], channel) for channel, spread in enumerate(self.noise)
        ]
        return torch.stack(draws, -1)

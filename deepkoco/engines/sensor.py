"""The sensor of a robot on a simulating engine."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.engines.noise import draw_keys, normal
from deepkoco.engines.start import start_state
from deepkoco.graph import Delay, Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import Parameters, System
from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.effects.hysteresis import SETTLED

TOUCH = 1.0 - 1e-9  # share of the play from which on the joint touches its output


class Sensor(Node):
    """Measures the world's last state; the output is (B, N).

    Before the first message has come a receiver sees a measurement of the start state: the parameter
    ``start`` (B, S), or what the runtime's reset gives as ``initial``.

    Behind a play between a joint and its sensors, the output follows once the joint has crossed the play:
    y_k = min(max(y_{k-1}, q_k - w), q_k + w) over the ticks of the world. The sensor then needs all states since its
    last measurement: connect it with a window of `states_between`.

    Args:
        system: Declares the measurements.
        rate: Measurements per second [Hz].
        noise: Standard deviation of the noise per channel, in the channel's unit.

    Source: as for :mod:`deepkoco.systems.effects.hysteresis`.
    """

    free_rate = True

    def __init__(self, system: System, rate: float, noise: tuple[float, ...]) -> None:
        super().__init__("sensor", rate)
        self.system, self.noise = system, noise
        self.noisy = any(spread > 0.0 for spread in noise)
        play = system.output_play(system.default_parameters())
        self.loose = tuple(j for j, width in enumerate(play) if width is not None)

    def least_window(self, delay: Delay, sender: Node) -> int:
        """Behind a play, the states of the world between two measurements."""
        return max(1, math.ceil(float(sender.rate) / float(self.rate))) if self.loose else 1

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        state = {"start": start_state(self.system, parameters, batch)}
        if self.noisy:
            state["key"] = draw_keys(batch, generator)
            state["tick"] = torch.zeros(batch, dtype=torch.int64)
        if self.loose:
            state["output"] = torch.zeros(batch, len(self.loose), dtype=torch.float64)
            state["seen"] = torch.full((batch,), -1, dtype=torch.int64)
            state["followed"] = torch.zeros(batch, dtype=torch.bool)
        return state

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        shown = state["start"]
        if self.loose:
            play = self.system.output_play(parameters)
            shown = self._behind(shown, self._settled(shown, play), play)
        clean = self.system.measure_shown(shown, parameters)
        return clean + self._draw(state) if self.noisy else clean

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        shown = inputs["world"].data[:, -1]
        if self.loose:
            state, shown = self._followed(parameters, state, inputs["world"])
        clean = self.system.measure_shown(shown, parameters)
        if not self.noisy:
            return state, clean
        return {**state, "tick": state["tick"] + 1}, clean + self._draw(state)

    def _followed(self, parameters: Parameters, state: State, world: Input) -> tuple[State, Tensor]:
        """The outputs behind the plays after the states that have come since the last measurement."""
        play = self.system.output_play(parameters)
        settled = self._settled(state["start"], play)
        outputs = torch.where(state["followed"][:, None], state["output"], torch.stack(settled, -1)).unbind(
            -1
        )
        for k in range(world.data.shape[1]):
            new = world.seq[:, k] > state["seen"]
            outputs = tuple(
                torch.where(new, torch.minimum(torch.maximum(y, q - w), q + w), y)
                for y, q, w in self._pairs(outputs, world.data[:, k], play)
            )
        after = {
            "output": torch.stack(outputs, -1),
            "seen": torch.maximum(world.seq[:, -1], state["seen"]),
            "followed": torch.ones_like(state["followed"]),
        }
        return {**state, **after}, self._behind(world.data[:, -1], outputs, play)

    def _settled(self, start: Tensor, play: Levels) -> tuple[Tensor, ...]:
        """Outputs at the start, as if each joint had moved with its first speed for a while."""
        joints, outputs = self.system.joints, []
        for j in self.loose:
            width = play[j]
            assert width is not None
            way = SETTLED * start[:, joints + j]
            outputs.append(start[:, j] - torch.minimum(torch.maximum(way, -width), width))
        return tuple(outputs)

    def _behind(self, state: Tensor, outputs: tuple[Tensor, ...], play: Levels) -> Tensor:
        """A state (B, S) as the sensors behind the plays see it: while a joint crosses its play, the output rests."""
        joints, parts = self.system.joints, list(state.unbind(-1))
        for j, (y, q, w) in zip(self.loose, self._pairs(outputs, state, play), strict=True):
            speed = parts[joints + j]
            touches = (q - y) * torch.sign(speed) >= TOUCH * w
            parts[j], parts[joints + j] = y, torch.where(touches, speed, 0.0)
        return torch.stack(parts, -1)

    def _pairs(
        self, outputs: tuple[Tensor, ...], state: Tensor, play: Levels
    ) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Output, position and width of the play of each loose joint."""
        found = []
        for j, y in zip(self.loose, outputs, strict=True):
            width = play[j]
            assert width is not None
            found.append((y, state[:, j], width))
        return found

    def _draw(self, state: State) -> Tensor:
        """Noise of this tick (B, N)."""
        draws = [
            spread * normal(state["key"], state["tick"], channel) for channel, spread in enumerate(self.noise)
        ]
        return torch.stack(draws, -1)

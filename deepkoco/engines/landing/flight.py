"""A quadrotor in flight whose attitude is told, and its sensor."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.engines.command_window import command_window
from deepkoco.engines.hold import mean_over_tick
from deepkoco.engines.ode import World
from deepkoco.engines.sensor import Sensor
from deepkoco.graph import Delay, Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import Parameters
from deepkoco.systems.bodies.quadrotor import STEEPEST, Quadrotor
from deepkoco.systems.bodies.quadrotor_height import FULL_THRUST
from deepkoco.systems.landing.touchdown import thrust_axis


class Flight(World):
    """The system `quadrotor` in ticks of 1/rate; each of its commands has the whole delay of its kind in here.

    Input: ``command`` (B, 3) thrust [N], roll and pitch [rad].

    Output, in parts: ``state`` (B, 6), and ``axis`` (B, 3), the unit vector along which it pushes.

    Args:
        rate: Ticks per second [Hz].
        speed_limit: It goes no faster along each axis [m/s].
        longest_delay: Longest of the delays of its commands in any environment [s].
    """

    inputs = ("command",)
    outputs = {"state": ((6,), torch.float64), "axis": ((3,), torch.float64)}  # noqa: RUF012

    def __init__(self, rate: float, speed_limit: float, longest_delay: float) -> None:
        super().__init__(
            Quadrotor(), rate, command_limit=(FULL_THRUST, STEEPEST, STEEPEST), speed_limit=speed_limit
        )
        self.longest_delay = longest_delay

    def least_window(self, delay: Delay, sender: Node) -> int:
        """Of commands, those of a tick and the one before them, whichever of the three is the latest."""
        return command_window(delay, float(sender.rate), float(self.rate), self.longest_delay)

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return self._shown(state, self._complete(parameters))

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input]
    ) -> tuple[State, dict[str, Tensor]]:
        own = self._complete(parameters)
        after, _ = super().step(own, state, {"agent": inputs["command"]})
        return after, self._shown(after, own)

    def _delivered(self, efforts: Tensor, commands: Input, parameters: Parameters) -> Tensor:
        means = []
        for index in range(efforts.shape[-1]):
            delay = self.system.command_timing(index, parameters).delay
            late = commands.t_received + (delay.unsqueeze(-1) if delay.ndim else delay)
            means.append(mean_over_tick(efforts[..., index], commands._replace(t_received=late), self.period))
        return torch.stack(means, -1)

    def _complete(self, parameters: Parameters) -> Parameters:
        return {**self.system.default_parameters(), **parameters}

    @staticmethod
    def _shown(state: State, parameters: Parameters) -> dict[str, Tensor]:
        _, roll, pitch = state["effort"].unbind(-1)
        axis = thrust_axis(parameters["roll_gain"] * roll, parameters["pitch_gain"] * pitch)
        return {"state": state["state"], "axis": axis}


class FlightSensor(Sensor):
    """Measures place and velocity of a `Flight`, (B, 6).

    Args:
        rate: Measurements per second [Hz].
        noise: It has the noise that the channels of the system declare.
    """

    inputs = ("world",)

    def __init__(self, rate: float, noise: bool) -> None:
        system = Quadrotor()
        super().__init__(system, rate, tuple(c.noise_sd if noise else 0.0 for c in system.measurements))

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        world = inputs["world"]
        return super().step(parameters, state, {"world": world._replace(data=world.data["state"])})

"""A body that flies, and the circle that it shall follow."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.system import System
from deepkoco.systems.wrapped import WrappedSystem

NEAR = 1e-6  # a body this close to the axis has no direction from it [m]
WHERE = {"radius": "m", "speed": "m/s"}


class CirclePath(WrappedSystem):
    """A system whose first three states are x, y and z, with a level circle about the origin.

    Radius [m] and speed along it [m/s] stand behind the system's states and measurements; they do not change. The point
    of the path is the one next to the body, so nothing has to be caught up with: what counts is the place, and the
    speed along the path.

    Args:
        base: The system, with positions and speeds of all three axes measured.
    """

    def __init__(self, base: System) -> None:
        super().__init__(base)
        self.state_names = (*base.state_names, *WHERE)
        self.state_units = (*base.state_units, *WHERE.values())
        path = (
            Channel(n, u, "measurement", 0.0, 10.0, description=f"{n} of the path") for n, u in WHERE.items()
        )
        self.measurements = (*base.measurements, *path)

    @property
    def measured_states(self) -> tuple[int, ...]:
        first = len(self.base.state_names)
        return (*self.base.measured_states, first, first + 1)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        slope = self.base.derivative(state[..., :-2], effort, parameters)
        # Made of the state: the compiled executor broadcasts no constants of its own.
        return torch.cat([slope, torch.zeros_like(state[..., -2:])], -1)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        return torch.cat([self.base.ideal_measurement(state[..., :-2]), state[..., -2:]], -1)

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.base.measure(state[..., :-2], parameters), state[..., -2:]], -1)

    def measure_shown(self, shown: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.base.measure_shown(shown[..., :-2], parameters), shown[..., -2:]], -1)

    def measure_at(self, state: Tensor, time: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.base.measure_at(state[..., :-2], time, parameters), state[..., -2:]], -1)

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        x, y, z = (float(value) for value in measurement[:3])
        drawing.draw_flight_from_above(image, (x, y, z), float(measurement[-2]))


def outwards(place: Tensor) -> tuple[Tensor, Tensor]:
    """Direction (cos, sin), each (...), from the axis of the circle to a place (..., 3); that of x on the axis."""
    x, y = place[..., 0], place[..., 1]
    length = torch.sqrt(x * x + y * y)
    distance, central = length.clamp_min(NEAR), length < NEAR
    return torch.where(central, 1.0, x / distance), torch.where(central, 0.0, y / distance)

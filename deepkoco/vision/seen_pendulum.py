"""The pendulum with what a camera and a tachometer show of it: the model that a fit of their log takes."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.bodies.pendulum import Pendulum
from deepkoco.systems.channel import Channel
from deepkoco.systems.joint import speed_channel
from deepkoco.systems.motion import CommandTiming
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.vision.projection import CAMERA, SIDE, angle_of_pixel, nearest_turn, pixel_of_angle

SENSING = (
    Parameter("camera_delay", 0.0, "s", 0.0, 0.1, 0.02, "middle of the exposure to the stamp of the picture"),
    Parameter("tacho_gain", 1.0, "1", 0.5, 2.0, 0.05, "shown speed by speed"),
    Parameter("tacho_zero", 0.0, "rad/s", -2.0, 2.0, 0.2, "shown speed at rest"),
)


class SeenPendulum(Pendulum):
    """As `Pendulum`; measured are the pixel of the mass, by a camera that is not quite known, and the speed.

    The channels ``bearing`` [rad] and ``reach`` [arms] are what `AngleReader` makes of a pixel with the nominal camera:
    the true pixel, under the camera parameters of this system, read by the nominal ones. A pixel has two numbers, and
    so have they. The camera lags by ``camera_delay``; the tachometer ``omega`` is at once. A log may lack ``omega``.

    Parameters: seven of the pendulum, eight of `CAMERA`, ``camera_delay``, ``tacho_gain``, ``tacho_zero``. The fit adds
    its effects: ``actuation_delay.delay``, ``torque_bias.effort`` and all others of the pendulum.

    Args:
        side: Width and height of the picture [px].
    """

    name = "seen_pendulum"

    def __init__(self, side: int = SIDE) -> None:
        super().__init__()
        self.side = side
        self.parameters = (*self.parameters, *CAMERA, *SENSING)
        self.nominal_camera = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in CAMERA}
        self.measurements = (
            Channel(
                "bearing", "rad", "measurement", noise_sd=0.003, angle=True,
                description="angle of the mass as the nominal camera reads it",
            ),
            Channel(
                "reach", "1", "measurement", noise_sd=0.003,
                description="distance of the mass from the pivot as the nominal camera reads it [arms]",
            ),
            speed_channel(0.05),
        )  # fmt: skip

    @property
    def measured_states(self) -> tuple[int, ...]:
        return 0, 2, 1  # the reach shows none of the two states

    def ideal_measurement(self, state: Tensor) -> Tensor:
        theta, omega = state.unbind(-1)
        return torch.stack([theta, torch.ones_like(theta), omega], -1)

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        theta, omega = state.unbind(-1)
        camera = {**self.nominal_camera, **parameters}
        pixel = pixel_of_angle(theta, camera, self.side)
        bearing, reach = angle_of_pixel(*pixel, self.nominal_camera, self.side)
        speed = parameters["tacho_gain"] * omega + parameters["tacho_zero"]
        return torch.stack(torch.broadcast_tensors(nearest_turn(bearing, theta), reach, speed), -1)

    def channel_delays(self, parameters: Parameters) -> dict[int, Tensor]:
        return {0: parameters["camera_delay"], 1: parameters["camera_delay"]}

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        # Along a log the state is the one that the camera, the latest channel, shows.
        zero = torch.zeros((), dtype=torch.float64)
        return CommandTiming(parameters["camera_delay"], (), zero)

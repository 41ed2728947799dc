"""What equations of motion read and give, and the times of what drives and shows a motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameter

Acceleration = Callable[["Motion"], tuple[Tensor, ...]]
Delivery = Callable[["Motion"], tuple[Tensor, ...]]
InverseInertia = Callable[["Motion"], tuple[tuple[Tensor, ...], ...]]


class Motion(NamedTuple):
    """Joint coordinates and what acts on them; every tensor has the batch shape (...)."""

    angles: tuple[Tensor, ...]  # J joint coordinates [rad or m]
    speeds: tuple[Tensor, ...]  # J, per second
    efforts: tuple[Tensor, ...]  # M, in the commands' units
    loads: tuple[Tensor | None, ...] | None = None  # J outside loads [N m or N]
    time: Tensor | None = None  # log time [s]
    # J speeds over which the sign of dry friction changes; infinite where dry friction is left out
    smoothing: tuple[Tensor, ...] | None = None

    def load(self, joint: int) -> Tensor | float:
        """Outside load on a joint [N m or N]; 0 where there is none."""
        given = None if self.loads is None else self.loads[joint]
        return 0.0 if given is None else given

    def direction(self, joint: int, over: float = 0.05) -> Tensor:
        """Smoothed sign of the speed of a joint, from -1 to 1 (...), for dry friction in equations of motion.

        It is 0 where a simulation lets the joint stick and adds the declared dry friction itself.

        Args:
            joint: Number of the joint.
            over: Speed over which the sign changes where the caller asks for none [rad/s or m/s].
        """
        return torch.tanh(self.speeds[joint] / (over if self.smoothing is None else self.smoothing[joint]))


class Timing(NamedTuple):
    """Delays that a system carries besides its equations, all in seconds."""

    actuation_delay: Tensor  # command sent -> command acts
    sensing_delay: Tensor  # state -> measurement stamped
    lag: Tensor  # time constant of the actuator's first-order lag


class CommandTiming(NamedTuple):
    """What happens in time to one command on its way to the joint."""

    delay: Tensor  # sensing delay included: along a log the two act alike [s]
    lag: tuple[Tensor, ...]  # time constants of first-order lags in series [s]
    skew: Tensor  # seconds that the measurements' clock gains per second


POINT = ("along", "across", "beside")
"""Coordinates of a pushed point: along a link's line, square to it and the joint's axis, and square to these two."""


class PushPlace(NamedTuple):
    """A body on which a push from outside loads several joints.

    Attributes:
        body: Its name.
        joint: The joint that moves it.
        parameters: Components ``x``, ``y``, ``z`` of the force in the frame of the world that load a joint [N], and
            those of `POINT` that a motion shows: distances of the point from the body's centre of mass [m].
        directions: These names of `POINT`, each with its unit vector in the joint's frame.
    """

    body: str
    joint: int
    parameters: tuple[Parameter, ...]
    directions: tuple[tuple[str, tuple[float, float, float]], ...] = ()


class PayloadWay(NamedTuple):
    """The line along a link on which a payload may hang, by its distance from the link's joint.

    Attributes:
        at: Where it is taken to hang if nothing else is known [m].
        low, high: Bounds [m].
        sd: Standard deviation of its prior [m].
    """

    at: float
    low: float
    high: float
    sd: float

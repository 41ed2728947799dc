"""The supervisor of a landing: what it sees, and what it pays."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.engines.landing.motor_stop import outside
from deepkoco.engines.landing.touchdown import TOLD
from deepkoco.graph import Input, Supervisor
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.bodies.quadrotor import STEEPEST
from deepkoco.systems.bodies.quadrotor_height import FULL_THRUST
from deepkoco.systems.landing import LIMITS, Meeting, TouchdownLimits, succeeded

CENTRE = (0.5 * FULL_THRUST, 0.0, 0.0)
SCALE = (0.5 * FULL_THRUST, STEEPEST, STEEPEST)
"""An action of [-1, 1] times the scale, and the centre, is a command: thrust [N], roll and pitch [rad]."""
FAR, HIGH = 2.5, 2.0
"""The room about the deck: along x and y, and above [m]."""
BOUNDS = (*(2.0 * FAR,) * 3, *(10.0,) * 3, 1.5, 1.5, *(3.0,) * 2, 2.0 * FAR, 1.5, 1.5)
"""Symmetric bounds of an observation without past actions: way, velocity, normal, velocity of the deck, height, and
the normal once more where it is close."""
NEAR = 0.3  # about within this distance the attitude of the deck matters [m]


class LandingSeat(Supervisor):
    """Sends thrust, roll and pitch, (B, 3), until the body has touched the deck or left the room.

    The cost of a step is ``hurry``, ``approach`` times the distance from the deck [m], and ``align`` times the square
    of the angle between thrust axis and normal over its limit, times exp(-(distance / ``near``)^2): a body in the wrong
    attitude stays away from the deck until it comes to land. A touch-down ends the episode; it costs the sum of the
    squares of offset, sink, slip and tilt, each over its limit and at most ``worst``, and ``failure`` more if it is no
    landing. Hitting the ground or leaving the room ends it too, and costs ``crash``.

    Readings: ``observation`` (B, 13 + 3 history) along the axes of the world, as the commands are: the measured way
    from the centre of the deck and the velocity against it, the horizontal part of its normal, its velocity along x and
    y, the height over its plane, and the horizontal part of the normal times exp(-(distance / 0.3 m)^2), so that to
    tilt close to the deck only is linear in what is seen; then the past actions, newest first. ``reward``;
    ``terminated``; of the truth, (B,) each, ``touched``, ``success``, ``offset``, ``sink``, ``slip`` and ``tilt`` of
    the touch-down (0 before), and ``distance`` from the deck [m].

    Args:
        rate: Decisions per second [Hz].
        idle: Command (3,) that is held before the first one.
        history: How many past actions the observation has.
        limits: What a landing is.
        hurry, approach, align, near, worst, failure, crash: Of the cost, see above; ``approach`` [1/m], ``near`` [m].
    """

    inputs = ("sensor", "deck_sensor", "touchdown")
    free_rate = True

    def __init__(
        self,
        rate: float,
        idle: Tensor,
        history: int,
        limits: TouchdownLimits = LIMITS,
        hurry: float = 0.4,
        approach: float = 0.1,
        align: float = 0.1,
        near: float = NEAR,
        worst: float = 3.0,
        failure: float = 6.0,
        crash: float = 60.0,
    ) -> None:
        super().__init__("agent", rate, initial_action=idle, phase=0)
        self.history, self.limits = history, limits
        self.hurry, self.approach, self.align, self.near, self.worst = hurry, approach, align, near, worst
        self.failure, self.crash = failure, crash

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"actions": torch.zeros(batch, len(SCALE) * self.history, dtype=torch.float64)}

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        body, deck = inputs["sensor"].data[:, -1], inputs["deck_sensor"].data
        place, velocity, normal = (deck[name][:, -1] for name in ("place", "velocity", "normal"))
        observation = observed(body, place, velocity, normal)
        if self.history:
            parts = action.unbind(-1)
            scaled = [(a - c) / s for a, c, s in zip(parts, CENTRE, SCALE, strict=True)]
            past = torch.cat([torch.stack(scaled, -1), state["actions"][:, : -len(SCALE)]], 1)
            state = {"actions": past}
            observation = torch.cat([observation, past], 1)
        truth = {name: value[:, -1] for name, value in inputs["touchdown"].data.items()}
        touched = truth["touched"] > 0.5
        met = Meeting(height=torch.zeros_like(truth["offset"]), **{name: truth[name] for name in TOLD})
        lands = touched & succeeded(met, self.limits)
        left = outside(truth["way"], FAR, HIGH) & ~touched
        distance = torch.sqrt((truth["way"] * truth["way"]).sum(-1))
        close = torch.exp(-((distance / self.near) ** 2))
        cost = (
            self.hurry
            + self.approach * distance
            + self.align * close * (truth["lean"] / self.limits.tilt) ** 2
        )
        cost = cost + torch.where(left, self.crash, 0.0)
        cost = cost + torch.where(touched, self._paid(met) + torch.where(lands, 0.0, self.failure), 0.0)
        readings = {
            "observation": observation,
            "reward": -cost,
            "terminated": touched | left,
            "touched": touched,
            "success": lands,
            **{name: truth[name] for name in TOLD},
            "distance": distance,
        }
        return state, readings

    def _paid(self, met: Meeting) -> Tensor:
        """Cost (B,) of a touch-down."""
        cost = torch.zeros_like(met.offset)
        for name in TOLD:
            over = getattr(met, name) / getattr(self.limits, name)
            cost = cost + torch.clamp(torch.abs(over), max=self.worst) ** 2
        return cost


def observed(body: Tensor, place: Tensor, velocity: Tensor, normal: Tensor) -> Tensor:
    """What an agent sees (..., 13) of a measured body (..., 6) and of a deck's place, velocity and normal (..., 3)."""
    way = body[..., :3] - place
    closing = body[..., 3:6] - velocity
    height = (way * normal).sum(-1)
    close = torch.exp(-(way * way).sum(-1) / NEAR**2)[..., None] * normal[..., :2]
    parts = torch.cat([way, closing, normal[..., :2], velocity[..., :2], height[..., None], close], -1)
    entries = [part.clamp(-bound, bound) for part, bound in zip(parts.unbind(-1), BOUNDS, strict=True)]
    return torch.stack(entries, -1)

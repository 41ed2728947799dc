"""A machine of which a part of the inertia at a driven joint hangs on something that gives: a belt, a long shaft.

The system as given moves all of a joint's inertia with its motor. Here the share r of it is behind a spring and a
damper. With the stretch e of the joint (the part behind minus the part in front),

    phi = w^2 e + 2 z w e',    (1 - r) q'' = a + r phi,    e'' = -phi - q'',

where a is the acceleration of the system as given under the same state and efforts, w the natural frequency of the part
behind while the motor is held, and z its damping ratio. Rigidly coupled (e = 0), both lines give q'' = a. Loads on the
joint, friction among them, act in front; other joints answer to the reaction through the inverse inertia: the rank-one
update of Sherman and Morrison for the inertia that is taken off the joint. A share of 0 is the system as given.

Source: Spong, Modeling and Control of Elastic Joint Robots, Journal of Dynamic Systems, Measurement, and Control
    109(4), 1987; Golub and Van Loan, Matrix Computations, 2.1.4, for the update of the inverse.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.drawn import Outline
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.joint_memory import JointMemory
from deepkoco.systems.motion import Acceleration, Delivery, InverseInertia, Motion
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.rollout import Rollout
from deepkoco.systems.system import System
from deepkoco.systems.wrapped import WrappedSystem

LONGEST_STEP = 0.003  # that follows the fastest part behind that is looked for [s]


class ElasticDrive(WrappedSystem):
    """A system with one more coordinate for each driven joint: by how much its drive is stretched.

    The stretch does nothing until an effect ``elastic`` gives the joint a share behind its drive, see
    :mod:`deepkoco.systems.effects.elastic`. The state is all angles of the base, all stretches, all speeds of the base,
    and the rates of the stretches.

    Args:
        base: A plain system of which the state is angles and speeds.

    Attributes:
        driven: Joint that each stretch belongs to.
    """

    def __init__(self, base: System) -> None:
        super().__init__(base)
        self.driven = tuple(dict.fromkeys(j for j in base.command_joints if j < base.joints))
        self._own = base.joints
        self.joints = base.joints + len(self.driven)
        names, units, count = base.state_names, base.state_units, base.joints
        stretched = tuple(f"stretch of {base.joint_names[j]}" for j in self.driven)
        rates = tuple(f"rate of the {name}" for name in stretched)
        self.state_names = (*names[:count], *stretched, *names[count:], *rates)
        self.state_units = (
            *units[:count],
            *(units[j] for j in self.driven),
            *units[count:],
            *(units[count + j] for j in self.driven),
        )

    @property
    def own_joints(self) -> int:
        return self._own

    @property
    def joint_names(self) -> tuple[str, ...]:
        return (*self.base.joint_names, *self.state_names[self.own_joints : self.joints])

    def at_joint(self, name: str, joint: int) -> str:
        return (
            self.base.at_joint(name, joint)
            if joint < self.own_joints
            else f"{name}({self.joint_names[joint]})"
        )

    @property
    def measured_states(self) -> tuple[int, ...]:
        return tuple(k if k < self.own_joints else k + len(self.driven) for k in self.base.measured_states)

    @property
    def shows_states(self) -> bool:
        return self.base.shows_states

    @property
    def load_scales(self) -> tuple[float, ...]:
        return (*self.base.load_scales, *(self.base.load_scales[j] for j in self.driven))

    @property
    def load_scale(self) -> float:
        return self.base.load_scale

    @property
    def smoothing_speeds(self) -> tuple[float, ...]:
        speeds = self.base.smoothing_speeds
        return (*speeds, *(speeds[j] for j in self.driven))

    @property
    def longest_step(self) -> float:
        return min(self.base.longest_step, LONGEST_STEP)

    def loads_of_push(self, place: int, point: Tensor, angles: Sequence[Tensor]) -> Tensor:
        own = self.base.loads_of_push(place, point, angles[: self.own_joints])
        return torch.cat([own, torch.zeros_like(own[:, :1]).expand(-1, len(self.driven), *own.shape[2:])], 1)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        own, extra = self.own_joints, len(self.driven)
        return self.base.ideal_measurement(
            torch.cat([state[..., :own], state[..., own + extra : 2 * own + extra]], -1)
        )

    def accelerations(self, parameters: Parameters) -> Acceleration:
        return self._stretching(self.base.accelerations(parameters), parameters)

    def free_accelerations(self, parameters: Parameters) -> Acceleration:
        return self._stretching(self.base.free_accelerations(parameters), parameters)

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        return (*self.base.dry_friction_limits(parameters), *(None for _ in self.driven))

    def dry_friction_levels(self, parameters: Parameters) -> DryFriction:
        base, extra = self.base.dry_friction_levels(parameters), (None,) * len(self.driven)
        varying = base.varying

        def levels(motion: Motion, given: Levels) -> Levels:
            assert varying is not None
            return (*varying(self._in_front(motion), given[: self.own_joints]), *extra)

        return replace(base, steady=(*base.steady, *extra), varying=None if varying is None else levels)

    def joint_memory(self, parameters: Parameters) -> JointMemory:
        return JointMemory(())

    def delivery(self, parameters: Parameters) -> Delivery | None:
        deliver = self.base.delivery(parameters)
        return None if deliver is None else lambda motion: deliver(self._in_front(motion))

    def outline(self, angles: np.ndarray) -> Outline | None:
        return self.base.outline(angles[: self.own_joints])

    def output_play(self, parameters: Parameters) -> Levels:
        return (*self.base.output_play(parameters), *(None for _ in self.driven))

    def rollout(self, parameters: Parameters) -> Rollout | None:
        return None

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        return System.derivative(self, state, effort, parameters)

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        inverse, shares = self.base.inverse_inertia(parameters), self._shares(parameters)
        own, extra = self.own_joints, len(self.driven)

        def with_stretches(motion: Motion) -> tuple[tuple[Tensor, ...], ...]:
            rows = inverse(self._in_front(motion))
            for k, share in shares.items():
                rows = _lighter(rows, self.driven[k], share)
            none, one = torch.zeros_like(rows[0][0]), torch.ones_like(rows[0][0])
            front = tuple((*row, *(none for _ in self.driven)) for row in rows)
            behind = tuple(
                tuple(one if b == own + k else none for b in range(own + extra)) for k in range(extra)
            )
            return (*front, *behind)

        return with_stretches

    def _shares(self, parameters: Parameters) -> dict[int, Tensor]:
        """Number of each stretch whose drive is elastic -> share behind it."""
        names = {k: f"{self.at_joint('elastic', j)}.share" for k, j in enumerate(self.driven)}
        return {k: parameters[n] for k, n in names.items() if n in parameters}

    def _in_front(self, motion: Motion) -> Motion:
        """The motion without the stretches."""
        own = self.own_joints
        smoothing = motion.smoothing
        return motion._replace(
            angles=motion.angles[:own],
            speeds=motion.speeds[:own],
            loads=None if motion.loads is None else motion.loads[:own],
            smoothing=smoothing[:own] if isinstance(smoothing, tuple) else smoothing,
        )

    def _stretching(self, law: Acceleration, parameters: Parameters) -> Acceleration:
        own, shares = self.own_joints, self._shares(parameters)
        springs = {k: self._spring(k, parameters) for k in shares}
        inverse = self.base.inverse_inertia(parameters) if shares and own > 1 else None

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            front = self._in_front(motion)
            found = list(law(front))
            rates = [torch.zeros_like(motion.speeds[own + k]) for k in range(len(self.driven))]
            rows = None if inverse is None else inverse(front)
            pulls = {k: pull(motion.angles[own + k], motion.speeds[own + k]) for k, pull in springs.items()}
            for k, share in shares.items():
                j = self.driven[k]
                jump = share * (pulls[k] + found[j]) / (1.0 - share)  # of the joint's own acceleration
                if rows is not None:
                    others = [i for i in range(own) if i != j]
                    for i in others:
                        found[i] = found[i] + rows[i][j] / rows[j][j] * jump
                    rows = _lighter(rows, j, share) if len(shares) > 1 else rows
                found[j] = found[j] + jump
            for k, pull in pulls.items():
                rates[k] = -pull - found[self.driven[k]]
            return (*found, *rates)

        return acceleration

    def _spring(self, k: int, parameters: Parameters) -> Callable[[Tensor, Tensor], Tensor]:
        """(stretch, its rate) -> pull on the part in front, per inertia of the part behind."""
        name = self.at_joint("elastic", self.driven[k])
        omega = 2.0 * math.pi * parameters[f"{name}.frequency"]
        square, rate = omega**2, 2.0 * parameters[f"{name}.damping"] * omega
        return lambda stretch, speed: square * stretch + rate * speed


def _lighter(
    rows: tuple[tuple[Tensor, ...], ...], joint: int, share: Tensor
) -> tuple[tuple[Tensor, ...], ...]:
    """Return the inverse inertia (J rows) after a share of the inertia that a load on one joint moves is taken off."""
    column = [row[joint] for row in rows]
    more = share / ((1.0 - share) * column[joint])
    return tuple(
        tuple(entry + more * a * b for entry, b in zip(row, column, strict=True))
        for row, a in zip(rows, column, strict=True)
    )

"""Description of a tree of hinges and slides: plain numbers, without the file that they came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from deepkoco.systems.engine_names import MUJOCO

CLOSE = 1e-14  # entries of rotations that are this close to 0 or 1 are meant to be

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
"""Rows of a rotation: it takes coordinates of the inner frame to those of the outer one."""


class TreeError(ValueError):
    """A model cannot be compiled to a tree; the message names the element and the way out."""


class Frame(NamedTuple):
    """Place of an inner frame in an outer one."""

    rotation: Matrix
    offset: Vector  # [m]


class OutsideForce(NamedTuple):
    """A force of fixed direction in the world.

    Attributes:
        joint: Index of the joint with which its point moves.
        point: In the joint's frame [m].
        force: In the frame of the base [N]; each entry a number or of a shape that broadcasts against the motion's.
    """

    joint: int
    point: tuple[Any, Any, Any]
    force: tuple[Any, Any, Any]


@dataclass(frozen=True)
class Joint:
    """One degree of freedom. Its frame has its origin on the axis, and the axis is z.

    Attributes:
        name: Name in the model.
        slides: Whether it moves along its axis; else it turns about it.
        parent: Index of the joint before it on the way to the base; -1 for the base itself.
        frame: The joint's frame at its reference, in the frame of the parent after its motion.
        reference: Coordinate at which the frames are those of the file [rad or m].
        low, high: Range of the coordinate; infinite without one.
        damping: [N m s/rad or N s/m]
        frictionloss: Dry friction [N m or N].
        armature: Rotor inertia behind the gear [kg m2 or kg].
        stiffness: [N m/rad or N/m]
        springref: Coordinate at which the spring rests.
        force_low, force_high: Limits of what all actuators together deliver to it [N m or N].
    """

    name: str
    slides: bool
    parent: int
    frame: Frame
    reference: float
    low: float
    high: float
    damping: float
    frictionloss: float
    armature: float
    stiffness: float
    springref: float
    force_low: float
    force_high: float


@dataclass(frozen=True)
class Body:
    """What is fixed to a joint, with the bodies that are welded to it.

    Attributes:
        name: Name in the model.
        joint: Index of the joint that moves it.
        frame: The body's frame in the joint's.
        mass: [kg]
        com: Centre of mass in the body's frame [m].
        axes: Principal axes in the body's frame, as columns.
        moments: Principal moments about the centre of mass [kg m2].
        parts: Names of the bodies that are welded to it.
    """

    name: str
    joint: int
    frame: Frame
    mass: float
    com: Vector
    axes: Matrix
    moments: Vector
    parts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Site:
    """A named place that moves with a joint: its offset in the joint's frame [m]."""

    name: str
    joint: int
    offset: Vector


@dataclass(frozen=True)
class Actuator:
    """Force = clip((g0 + g1 l + g2 l') u + b0 + b1 l + b2 l'), with l = gear q; the joint gets gear times it.

    Attributes:
        name: Name in the model.
        joint: Index of the joint that it drives.
        gear: Length per coordinate.
        gain: g0, g1, g2.
        bias: b0, b1, b2.
        low, high: Range of the control u; infinite without one.
        force_low, force_high: Range of the force; infinite without one.
        time_constant: Of the first-order filter of the control; 0 without one [s].
        delay: Time after which a control acts [s].
    """

    name: str
    joint: int
    gear: float
    gain: Vector
    bias: Vector
    low: float
    high: float
    force_low: float
    force_high: float
    time_constant: float
    delay: float = 0.0


class Softness(NamedTuple):
    """How softly the engine of a file lets dry friction hold a joint.

    Attributes:
        inertia: With which it resists an acceleration, over the inertia that the joint moves at its reference.
        rate: At which it stops a motion while it is below its level [1/s].
        slowest: The rate is at most 1 over so many steps of the engine; 0 where no step limits it.
        bare: Whether the inertia that the joint moves is that of its body alone, without the joint's armature.
    """

    inertia: float
    rate: float
    slowest: float = 0.0
    bare: bool = False


@dataclass(frozen=True)
class Engine:
    """What a simulation of a tree by an engine does, and a machine does not.

    Attributes:
        softness: How softly dry friction holds each joint with the shortest of steps; None where it holds.
        step: Of the simulation [s].
        steps_ahead: Steps before its time at which a command acts.
        steps_late: Steps by which the speeds in all loads are late; below 0: early.
        steps_behind: Steps by which a speed that the engine shows is behind the position beside it.
        joints_ahead, drives_ahead: Steps by which the damping of joints, and of servos, is ahead of these speeds.
        name: Of :mod:`deepkoco.systems.engine_names`.
    """

    softness: tuple[Softness, ...] | None
    step: float
    steps_ahead: float = 0.0
    steps_late: float = 0.0
    steps_behind: float = 0.0
    joints_ahead: float = 0.0
    drives_ahead: float = 0.0
    name: str = MUJOCO

    @property
    def lead(self) -> float:
        """Time before its step at which a command acts [s]."""
        return self.steps_ahead * self.step

    @property
    def late(self) -> float:
        """Time by which the speeds in all loads are late [s]; below 0: early."""
        return self.steps_late * self.step

    @property
    def shown_late(self) -> float:
        """Time by which a speed that the engine shows is behind the position beside it [s]."""
        return self.steps_behind * self.step


@dataclass(frozen=True)
class Tree:
    """Joints in an order in which each comes after its parent, and what moves with them.

    Attributes:
        name: Name of the model.
        joints: J joints.
        bodies: Moving bodies; a body without joints belongs to the one that it is welded to.
        actuators: In the order of the model, but those after the first one of a joint come last.
        sites: Named places on moving bodies, first those of the model.
        gravity: Acceleration in the base's frame [m/s2].
        notes: Sentences on what the model has and the compiled tree leaves out.
        without_actuators: Whether the model has none, and the actuators are plain loads on the joints.
        supports: Forces that hold bodies up against gravity (gravcomp), at the masses of the model.
        engine: How the engine of its file simulates it; None without one.
    """

    name: str
    joints: tuple[Joint, ...]
    bodies: tuple[Body, ...]
    actuators: tuple[Actuator, ...]
    sites: tuple[Site, ...]
    gravity: Vector
    notes: tuple[str, ...] = ()
    without_actuators: bool = False
    supports: tuple[OutsideForce, ...] = ()
    engine: Engine | None = None


def matrix(rotation: np.ndarray) -> Matrix:
    """Rows as floats; what differs from 0 or 1 by rounding only is made exact."""
    tidy = np.where(np.abs(rotation) < CLOSE, 0.0, rotation)
    tidy = np.where(np.abs(np.abs(tidy) - 1.0) < CLOSE, np.sign(tidy), tidy)
    a, b, c = (vector(row) for row in tidy)
    return a, b, c


def vector(values: np.ndarray) -> Vector:
    """Three floats."""
    x, y, z = (float(v) + 0.0 for v in values)
    return x, y, z

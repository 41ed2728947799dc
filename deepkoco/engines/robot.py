"""Objects: what a graph is about, whatever engine runs it. One entry per object."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from deepkoco.engines.engine import EngineError, EngineObject
from deepkoco.engines.mjcf import HingedBody
from deepkoco.engines.mjcf_object import MjcfObject
from deepkoco.systems import Channel, JointSystem, System, make_system
from deepkoco.systems.bodies.pendulum import GRAVITY as STANDARD_GRAVITY

Values = Mapping[str, float]
MODELS = (".xml", ".mjcf", ".urdf")


@dataclass(frozen=True)
class RobotObject:
    """A pendulum with named actuators and sensors, for every engine.

    Attributes:
        system: Name of its dynamics in `deepkoco.systems`, and of the object.
        body: From the system's parameters, the rigid body that MuJoCo simulates.
    """

    system: str
    body: Callable[[Values], HingedBody]

    @property
    def dynamics(self) -> JointSystem:
        """Its nominal dynamics."""
        system = make_system(self.system)
        assert isinstance(system, JointSystem)
        return system

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """What takes commands."""
        return (self.dynamics.command,)

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """What is measured."""
        return self.dynamics.measurements


def _rod(p: Values) -> HingedBody:
    # A thin rod about its middle: m l^2 / 12.
    return HingedBody(
        mass=p["mass"],
        reach=0.5 * p["length"],
        inertia=p["mass"] * p["length"] ** 2 / 12.0,
        damping=p["viscous"],
        gear=1.0,
        gravity=p["gravity"],
    )


def _disk(p: Values) -> HingedBody:
    # The disk with the mass on it, about their common joint; what is not the mass's is taken about its place.
    drive = p["motor_constant"] / p["resistance"]
    return HingedBody(
        mass=p["mass"],
        reach=p["length"],
        inertia=p["inertia"] - p["mass"] * p["length"] ** 2,
        damping=p["viscous"] + drive * p["motor_constant"],
        gear=drive,
        gravity=STANDARD_GRAVITY,
        friction=p["coulomb"],
    )


def _point_on_rod(p: Values) -> HingedBody:
    # Its mass and length are not known apart; any pair with the same weight and inertia moves alike.
    reach = 0.5 * p["inertia"] * STANDARD_GRAVITY / p["gravity_torque"]
    mass = p["gravity_torque"] / (STANDARD_GRAVITY * reach)
    return HingedBody(
        mass=mass,
        reach=-reach,  # angle 0 hangs
        inertia=p["inertia"] - mass * reach**2,
        damping=p["viscous"],
        gear=1.0,
        gravity=STANDARD_GRAVITY,
    )


OBJECTS: dict[str, EngineObject] = {
    robot.system: robot
    for robot in (
        RobotObject("rod_pendulum", _rod),
        RobotObject("pendulum", _disk),
        RobotObject("torque_pendulum", _point_on_rod),
    )
}


@dataclass(frozen=True)
class SystemObject:
    """A machine that is given by its equations of motion, for the ``ode`` engine.

    Attributes:
        dynamics: The equations.
    """

    dynamics: System

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """What takes commands."""
        return self.dynamics.commands

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """What is measured."""
        return self.dynamics.measurements


def register_object(thing: EngineObject, name: str | None = None) -> EngineObject:
    """Let graphs find an object by a name, for this process.

    Args:
        thing: The object.
        name: Its name; None takes that of its system, for a `RobotObject`.

    Returns:
        ``thing``.

    Raises:
        EngineError: There is another object of that name, or the object needs one.
    """
    own = name or (thing.system if isinstance(thing, RobotObject) else None)
    if own is None:
        raise EngineError(
            f"a {type(thing).__name__} has no name of its own; give one: register_object(thing, name)"
        )
    if OBJECTS.get(own, thing) != thing:
        raise EngineError(f'there is an object "{own}" already; give another name')
    OBJECTS[own] = thing
    return thing


def find_object(what: str | Path | System | EngineObject) -> EngineObject:
    """Look up an object by name; one that is given is handed back.

    Args:
        what: Name of a built-in object; path of an MJCF or URDF file, or MJCF text; a system, or the text by which
            `load_system` finds one of the user's own (``my_robot.py:CartPole``); or an object.

    Raises:
        EngineError: There is none; the message lists them.
    """
    if isinstance(what, System):
        return SystemObject(what)
    if not isinstance(what, str | Path):
        return what
    text = str(what)
    if text in OBJECTS:
        return OBJECTS[text]
    if text.lstrip().startswith("<") or Path(text).suffix.lower() in MODELS:
        return MjcfObject(text)
    if ":" in text or text.endswith(".py"):
        from deepkoco.systems.loading import load_system

        return SystemObject(load_system(text))
    raise EngineError(f'no object "{text}"; known: {", ".join(OBJECTS)}, or the path of an MJCF or URDF file')

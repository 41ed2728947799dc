"""Names of the systems: those of the package, those of installed packages, and those registered at run time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from deepkoco.own_objects import OwnObjectError, entry_point, entry_point_names
from deepkoco.suggestion import did_you_mean
from deepkoco.systems.bodies.double_pendulum import DoublePendulum
from deepkoco.systems.bodies.furuta_pendulum import FurutaPendulum
from deepkoco.systems.bodies.pendulum import Pendulum
from deepkoco.systems.bodies.quadrotor import Quadrotor
from deepkoco.systems.bodies.quadrotor_height import QuadrotorHeight
from deepkoco.systems.bodies.rod_pendulum import RodPendulum
from deepkoco.systems.bodies.servo_pendulum import ServoPendulum
from deepkoco.systems.bodies.torque_pendulum import TorquePendulum
from deepkoco.systems.bodies.two_link_arm import TwoLinkArm
from deepkoco.systems.joint import JointSystem
from deepkoco.systems.system import System

JOINT_SYSTEMS: dict[str, type[JointSystem]] = {s.name: s for s in (Pendulum, RodPendulum, TorquePendulum)}
SYSTEMS: dict[str, Callable[[], System]] = {
    **JOINT_SYSTEMS,
    **{
        s.name: s
        for s in (TwoLinkArm, QuadrotorHeight, Quadrotor, DoublePendulum, FurutaPendulum, ServoPendulum)
    },
}
ENTRY_POINTS = "deepkoco.systems"  # group in which an installed package declares systems

Maker = TypeVar("Maker", bound=Callable[[], System])


class UnknownSystemError(ValueError):
    """A name does not belong to any system."""


class TakenNameError(ValueError):
    """A name is registered for something else already."""


class JointCountError(ValueError):
    """A system has more joints than what it is asked for can deal with."""


def register_system(maker: Maker, name: str | None = None) -> Maker:
    """Give a system a name for this process; usable as a decorator of the class.

    Args:
        maker: A subclass of `System`, or a function without arguments that makes a system.
        name: Its name; None takes the attribute ``name`` of the class.

    Returns:
        ``maker``.

    Raises:
        TakenNameError: Another system has the name.
        ValueError: Neither the argument nor the class gives a name.
    """
    given = name or getattr(maker, "name", None)
    if not isinstance(given, str):
        raise ValueError(f'{maker!r} has no name; give one: register_system(maker, "my_robot")')
    if given in SYSTEMS and _place(SYSTEMS[given]) != _place(maker):
        raise TakenNameError(f'there is a system "{given}" already; give another name')
    SYSTEMS[given] = maker
    return maker


def _place(maker: Callable[[], System]) -> tuple[str, str]:
    """Module and name: a class that is defined anew, as in a notebook, takes the place of its former self."""
    return getattr(maker, "__module__", ""), getattr(maker, "__qualname__", repr(maker))


def system_names() -> tuple[str, ...]:
    """Names that `make_system` takes."""
    return tuple(sorted({*SYSTEMS, *entry_point_names(ENTRY_POINTS)}))


def make_system(name: str) -> System:
    """System of the given name, with nominal parameters.

    Raises:
        UnknownSystemError: There is no such system, and the message lists those there are; or the package that
            declares it cannot be imported.
    """
    if name in SYSTEMS:
        return SYSTEMS[name]()
    try:
        declared = entry_point(ENTRY_POINTS, name)
    except KeyError:
        names = system_names()
        suggestion = did_you_mean(name, names)
        raise UnknownSystemError(
            f'unknown system "{name}"{suggestion or ";"} known systems: {", ".join(names)}'
        ) from None
    except OwnObjectError as error:
        raise UnknownSystemError(str(error)) from error
    system = declared if isinstance(declared, System) else declared()
    if not isinstance(system, System):
        raise UnknownSystemError(f'"{name}": the entry point makes a {type(system).__name__}, not a System')
    return system


def one_joint(system: str | System) -> JointSystem:
    """The system, for what takes a pendulum only: units, and engines that need one turning joint.

    Args:
        system: A system or its name.

    Raises:
        UnknownSystemError: There is no system of that name.
        JointCountError: It has more joints, or one that does not turn.
    """
    found = make_system(system) if isinstance(system, str) else system
    if not isinstance(found, JointSystem) or found.name not in JOINT_SYSTEMS:
        turns = "a joint behind a servo" if found.state_units[0] == "rad" else "a joint that does not turn"
        what = f"{found.joints} joints" if found.joints > 1 else turns
        raise JointCountError(
            f"{found.name} has {what}; this takes one that turns: choose one of {', '.join(sorted(JOINT_SYSTEMS))}"
        )
    return found

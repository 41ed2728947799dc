"""Names of the systems: a new system is one file and one line here."""

from __future__ import annotations

from deepkoco.suggestion import did_you_mean
from deepkoco.systems.bodies.double_pendulum import DoublePendulum
from deepkoco.systems.bodies.furuta_pendulum import FurutaPendulum
from deepkoco.systems.bodies.pendulum import Pendulum
from deepkoco.systems.bodies.quadrotor_height import QuadrotorHeight
from deepkoco.systems.bodies.rod_pendulum import RodPendulum
from deepkoco.systems.bodies.servo_pendulum import ServoPendulum
from deepkoco.systems.bodies.torque_pendulum import TorquePendulum
from deepkoco.systems.bodies.two_link_arm import TwoLinkArm
from deepkoco.systems.joint import JointSystem
from deepkoco.systems.system import System

JOINT_SYSTEMS: dict[str, type[JointSystem]] = {s.name: s for s in (Pendulum, RodPendulum, TorquePendulum)}
SYSTEMS: dict[str, type[System]] = {
    **JOINT_SYSTEMS,
    **{s.name: s for s in (TwoLinkArm, QuadrotorHeight, DoublePendulum, FurutaPendulum, ServoPendulum)},
}


class UnknownSystemError(ValueError):
    """A name does not belong to any system."""


class JointCountError(ValueError):
    """A system has more joints than what it is asked for can deal with."""


def make_system(name: str) -> System:
    """System of the given name, with nominal parameters.

    Raises:
        UnknownSystemError: There is no such system; the message lists those there are.
    """
    if name not in SYSTEMS:
        suggestion = did_you_mean(name, SYSTEMS)
        raise UnknownSystemError(
            f'unknown system "{name}"{suggestion or ";"} known systems: {", ".join(sorted(SYSTEMS))}'
        )
    return SYSTEMS[name]()


def one_joint(system: str | System) -> JointSystem:
    """The system, for what takes a pendulum only: units, and engines that need one turning joint.

    Args:
        system: A system or its name.

    Raises:
        UnknownSystemError: There is no system of that name.
        JointCountError: It has more joints, or one that does not turn.
    """
    found = any_system(system)
    if not isinstance(found, JointSystem) or found.name not in JOINT_SYSTEMS:
        turns = "a joint behind a servo" if found.state_units[0] == "rad" else "a joint that does not turn"
        what = f"{found.joints} joints" if found.joints > 1 else turns
        raise JointCountError(
            f"{found.name} has {what}; this takes one that turns: choose one of {', '.join(sorted(JOINT_SYSTEMS))}"
        )
    return found


def any_system(system: str | System) -> System:
    """The system itself, or the one of that name.

    Raises:
        UnknownSystemError: There is no system of that name.
    """
    return make_system(system) if isinstance(system, str) else system

"""Names of the systems: a new system is one file and one line here."""

from __future__ import annotations

from deepkoco.systems.pendulum import Pendulum
from deepkoco.systems.rod_pendulum import RodPendulum
from deepkoco.systems.system import System
from deepkoco.systems.torque_pendulum import TorquePendulum

SYSTEMS: dict[str, type[System]] = {s.name: s for s in (Pendulum, RodPendulum, TorquePendulum)}


class UnknownSystemError(ValueError):
    """A name does not belong to any system."""


def make_system(name: str) -> System:
    """System of the given name, with nominal parameters.

    Raises:
        UnknownSystemError: There is no such system; the message lists those there are.
    """
    if name not in SYSTEMS:
        raise UnknownSystemError(f'unknown system "{name}"; known systems: {", ".join(sorted(SYSTEMS))}')
    return SYSTEMS[name]()

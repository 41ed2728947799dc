"""Which systems can be given drives that give, and those systems with them."""

from __future__ import annotations

from collections.abc import Sequence

from deepkoco.systems.effects.elastic import ELASTIC
from deepkoco.systems.elastic_drive import ElasticDrive
from deepkoco.systems.extended import ExtendedSystem
from deepkoco.systems.system import System

KIND = ELASTIC.name
STATES = 2  # that a window has more for each drive: a stretch and its rate
MOST = 20  # parameters and states, below which a fit is quick


def may_stretch(system: System) -> bool:
    """Return whether drives of a system can be given a stretch: few joints, and no state beside angles and speeds.

    The compiled loop of a robot from a model file does not know a stretch, and torch is a hundred times slower.

    Args:
        system: Plain or extended system.
    """
    plain = system.base if isinstance(system, ExtendedSystem) else system
    if (
        isinstance(plain, ElasticDrive)
        or len(plain.state_names) != 2 * plain.joints
        or not plain.command_joints
    ):
        return False
    few = len(plain.parameters) + len(plain.state_names) + STATES * len(plain.command_joints) < MOST
    return few and plain.rollout(plain.default_parameters()) is None


def stretchable(system: System) -> System:
    """Return a system whose drives may give, with the effects and the values that it has."""
    if not isinstance(system, ExtendedSystem):
        return ElasticDrive(system)
    values = {p.name: p.value for p in system.parameters}
    return ExtendedSystem(ElasticDrive(system.base), tuple(e.name for e in system.effects), values)


def stretchable_if_asked(system: System, names: Sequence[str] | None) -> System:
    """Return the system with drives that may give, where causes to try are named and an elastic drive is one of them.

    Args:
        system: Plain or extended system.
        names: Names of causes; None for all.
    """
    given = [names] if isinstance(names, str) else names or ()
    asked = any(name.split("(")[0] == KIND for name in given)
    return stretchable(system) if asked and may_stretch(system) else system

"""A stand-in for a real robot: own physics, own process, hidden effects, and how to record it."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

# Names are looked up on first use: the process of a unit imports this package and must stay light.
_HOME = {
    "ControlLoop": "control",
    "ControlStats": "control",
    "EXCITATIONS": "excitation",
    "Excitation": "excitation",
    "ExcitationError": "excitation",
    "make_excitation": "excitation",
    "policy_excitation": "excitation",
    "SensorMessage": "messages",
    "UnitError": "messages",
    "Unit": "process",
    "SimulatedUnit": "simulated",
    "SensorSpec": "spec",
    "UnitSpec": "spec",
    "UnitSpecError": "unit_file",
    "load_unit": "unit_file",
    "make_unit": "unit_file",
}

if TYPE_CHECKING:
    from deepkoco.excitation.excitation import (
        EXCITATIONS,
        Excitation,
        ExcitationError,
        make_excitation,
        policy_excitation,
    )
    from deepkoco.unit.control import ControlLoop, ControlStats
    from deepkoco.unit.messages import SensorMessage, UnitError
    from deepkoco.unit.process import Unit
    from deepkoco.unit.simulated import SimulatedUnit
    from deepkoco.unit.spec import SensorSpec, UnitSpec
    from deepkoco.unit.unit_file import UnitSpecError, load_unit, make_unit

__all__ = [
    "EXCITATIONS",
    "ControlLoop",
    "ControlStats",
    "Excitation",
    "ExcitationError",
    "SensorMessage",
    "SensorSpec",
    "SimulatedUnit",
    "Unit",
    "UnitError",
    "UnitSpec",
    "UnitSpecError",
    "load_unit",
    "make_excitation",
    "make_unit",
    "policy_excitation",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)

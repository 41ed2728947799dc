"""Dynamical systems with named parameters, and the effects that extend them."""

from deepkoco.systems.extended import ExtendedSystem, ModelFileError, load_model, save_model
from deepkoco.systems.joint import JointSystem
from deepkoco.systems.registry import SYSTEMS, UnknownSystemError, make_system
from deepkoco.systems.system import (
    Channel,
    Parameter,
    ParameterError,
    Parameters,
    System,
    Timing,
    rk4_step,
)

__all__ = [
    "SYSTEMS",
    "Channel",
    "ExtendedSystem",
    "JointSystem",
    "ModelFileError",
    "Parameter",
    "ParameterError",
    "Parameters",
    "System",
    "Timing",
    "UnknownSystemError",
    "load_model",
    "make_system",
    "rk4_step",
    "save_model",
]

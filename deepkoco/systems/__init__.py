"""Dynamical systems with named parameters, and the effects that extend them."""

from deepkoco.systems.circling_target import CirclingTarget
from deepkoco.systems.extended import ExtendedSystem, ModelFileError, load_model, save_model
from deepkoco.systems.joint import JointSystem
from deepkoco.systems.registry import (
    JOINT_SYSTEMS,
    SYSTEMS,
    JointCountError,
    UnknownSystemError,
    make_system,
    one_joint,
)
from deepkoco.systems.system import (
    Channel,
    Parameter,
    ParameterError,
    Parameters,
    System,
    Timing,
    rk4_step,
)
from deepkoco.systems.two_link_arm import TwoLinkArm

__all__ = [
    "JOINT_SYSTEMS",
    "SYSTEMS",
    "Channel",
    "CirclingTarget",
    "ExtendedSystem",
    "JointCountError",
    "JointSystem",
    "ModelFileError",
    "Parameter",
    "ParameterError",
    "Parameters",
    "System",
    "Timing",
    "TwoLinkArm",
    "UnknownSystemError",
    "load_model",
    "make_system",
    "one_joint",
    "rk4_step",
    "save_model",
]

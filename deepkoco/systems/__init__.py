"""Dynamical systems with named parameters, and the effects that extend them."""

from deepkoco.systems.bodies.circling_target import CirclingTarget
from deepkoco.systems.bodies.quadrotor_height import QuadrotorHeight
from deepkoco.systems.bodies.two_link_arm import TwoLinkArm
from deepkoco.systems.channel import Channel
from deepkoco.systems.extended import ExtendedSystem, MemoryEffectError
from deepkoco.systems.joint import JointSystem
from deepkoco.systems.loading import any_system, load_system
from deepkoco.systems.model_yaml import ModelFileError, load_model, save_model
from deepkoco.systems.motion import CommandTiming, Motion, Timing
from deepkoco.systems.origins import SystemLoadError
from deepkoco.systems.parameter import Parameter, ParameterError, Parameters
from deepkoco.systems.registry import (
    JOINT_SYSTEMS,
    SYSTEMS,
    JointCountError,
    TakenNameError,
    UnknownSystemError,
    make_system,
    one_joint,
    register_system,
    system_names,
)
from deepkoco.systems.runge_kutta import rk4_step
from deepkoco.systems.system import System

__all__ = [
    "JOINT_SYSTEMS",
    "SYSTEMS",
    "Channel",
    "CirclingTarget",
    "CommandTiming",
    "ExtendedSystem",
    "JointCountError",
    "JointSystem",
    "MemoryEffectError",
    "ModelFileError",
    "Motion",
    "Parameter",
    "ParameterError",
    "Parameters",
    "QuadrotorHeight",
    "System",
    "SystemLoadError",
    "TakenNameError",
    "Timing",
    "TwoLinkArm",
    "UnknownSystemError",
    "any_system",
    "load_model",
    "load_system",
    "make_system",
    "one_joint",
    "register_system",
    "rk4_step",
    "save_model",
    "system_names",
]

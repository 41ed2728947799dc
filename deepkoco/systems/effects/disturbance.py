"""Disturbances: loads that follow the angle of the joint or the clock."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

FASTEST = 200.0  # [rad/s]
MOST_CYCLES = 100.0
PITCHES = (1e-3, 10.0)  # of the poles of a linear motor, a rack, a screw [m]
FARTHEST = 100.0  # centre of a spring [rad or m]


def _waves(system: System, joint: int) -> tuple[Parameter, Parameter]:
    limit, unit = system.load_scales[joint], system.load_units[joint]
    return (
        Parameter("sine", 0.0, unit, -limit, limit, 0.1 * limit, "amplitude of the sine"),
        Parameter("cosine", 0.0, unit, -limit, limit, 0.1 * limit, "amplitude of the cosine"),
    )


def _cogging(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if system.state_units[joint] == "m":
        if not system.dry_friction:
            return ()  # what flies has no rail
        text = "way after which the load comes back"
        return (*_waves(system, joint), Parameter("pitch", 0.02, "m", *PITCHES, 0.01, text))
    cycles = Parameter("cycles", 7.0, "1", 1.0, MOST_CYCLES, 1.0, "n, cycles per turn")
    return (*_waves(system, joint), cycles)


def _cogging_load(joint: JointState, p: Parameters) -> Tensor:
    phase = (2.0 * math.pi / p["pitch"] if "pitch" in p else p["cycles"]) * joint.angle
    return p["sine"] * torch.sin(phase) + p["cosine"] * torch.cos(phase)


def _periodic(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    frequency = Parameter("frequency", 10.0, "rad/s", 0.01, FASTEST, 1.0, "angular frequency")
    return (*_waves(system, joint), frequency)


def _periodic_load(joint: JointState, p: Parameters) -> Tensor:
    if joint.time is None:
        if not bool(((p["sine"] != 0.0) | (p["cosine"] != 0.0)).any()):
            return torch.zeros_like(joint.speed)
        raise ValueError("a periodic disturbance needs the time; it can be simulated along a log only")
    phase = p["frequency"] * joint.time
    return p["sine"] * torch.sin(phase) + p["cosine"] * torch.cos(phase)


def _spring(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    limit, load, unit = system.load_scales[joint], system.load_units[joint], system.state_units[joint]
    text = "q0, where the spring pulls nowhere"
    return (
        Parameter("stiffness", 0.0, f"{load}/{unit}", -10.0 * limit, 10.0 * limit, 0.2 * limit, "k, spring"),
        Parameter("centre", 0.0, unit, -FARTHEST, FARTHEST, 1.0, text),
    )


def _spring_load(joint: JointState, p: Parameters) -> Tensor:
    return -p["stiffness"] * (joint.angle - p["centre"])


def _constant(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    pairs = zip(system.command_joints, system.drives, strict=True)
    if any(drive.constant for driven, drive in pairs if driven == joint):
        return ()  # there it is a bias of the effort
    limit, unit = system.load_scales[joint], system.load_units[joint]
    return (Parameter("load", 0.0, unit, -limit, limit, 0.1 * limit, "constant load"),)


def _constant_load(joint: JointState, p: Parameters) -> Tensor:
    return p["load"] + torch.zeros_like(joint.speed)


CONSTANT_LOAD = Effect(
    "constant_load",
    "disturbance",
    "load",
    _constant,
    "a constant load acts on a joint",
    _constant_load,
)
SPRING = Effect("spring", "disturbance", "load", _spring, "a spring pulls the joint to a place", _spring_load)
COGGING = Effect(
    "cogging",
    "actuator",
    "load",
    _cogging,
    "a load that comes back every part of a turn, or every pitch of a slide",
    _cogging_load,
)
PERIODIC = Effect(
    "periodic", "actuator", "load", _periodic, "an outside load that comes back in time", _periodic_load
)

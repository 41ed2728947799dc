"""Actuator effects: what happens to a command before it becomes an effort, without memory."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint import JointSystem
from deepkoco.systems.system import Parameter, Parameters


def _gain(system: JointSystem) -> tuple[Parameter, ...]:
    return (Parameter("factor", 1.0, "1", -3.0, 10.0, 0.3, "k, effort per command"),)


def _apply_gain(command: Tensor, p: Parameters) -> Tensor:
    return p["factor"] * command


def _bias(system: JointSystem) -> tuple[Parameter, ...]:
    limit = system.command.high
    unit = system.command.unit
    return (Parameter("effort", 0.0, unit, -limit, limit, 0.2 * limit, "u0, effort at zero command"),)


def _apply_bias(command: Tensor, p: Parameters) -> Tensor:
    return command + p["effort"]


def _dead_zone(system: JointSystem) -> tuple[Parameter, ...]:
    limit = system.command.high
    return (Parameter("width", 0.0, system.command.unit, 0.0, limit, 0.2 * limit, "w, half width"),)


def _apply_dead_zone(command: Tensor, p: Parameters) -> Tensor:
    return torch.sign(command) * torch.clamp(command.abs() - p["width"], min=0.0)


def _saturation(system: JointSystem) -> tuple[Parameter, ...]:
    limit = system.command.high
    unit = system.command.unit
    return (Parameter("limit", limit, unit, 0.02 * limit, limit, limit, "u_max, largest effort"),)


def _apply_saturation(command: Tensor, p: Parameters) -> Tensor:
    return torch.maximum(torch.minimum(command, p["limit"]), -p["limit"])


GAIN = Effect("gain", "actuator", "command", _gain, "the actuator scales its command", _apply_gain)
TORQUE_BIAS = Effect(
    "torque_bias", "actuator", "command", _bias, "a constant effort adds to the command", _apply_bias
)
DEAD_ZONE = Effect(
    "dead_zone", "actuator", "command", _dead_zone, "small commands have no effect", _apply_dead_zone
)
SATURATION = Effect(
    "saturation", "actuator", "command", _saturation, "large commands are cut off", _apply_saturation
)

"""Sensor effects: what happens to a measurement, without memory."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.system import Parameter, Parameters, System


def _bias(system: System) -> tuple[Parameter, ...]:
    return (Parameter("angle", 0.0, "rad", -0.5, 0.5, 0.1, "theta0, zero error of the angle sensor"),)


def _apply_bias(measurement: Tensor, p: Parameters) -> Tensor:
    angle = measurement[..., :1] + torch.as_tensor(p["angle"]).unsqueeze(-1)
    return torch.cat([angle, measurement[..., 1:]], -1)


def _scale(system: System) -> tuple[Parameter, ...]:
    return (Parameter("factor", 1.0, "1", 0.3, 3.0, 0.1, "k_s, reading per true value"),)


def _apply_scale(measurement: Tensor, p: Parameters) -> Tensor:
    return measurement * torch.as_tensor(p["factor"]).unsqueeze(-1)


SENSOR_BIAS = Effect("sensor_bias", "sensor", "sensor", _bias, "the angle sensor's zero is off", _apply_bias)
SENSOR_SCALE = Effect(
    "sensor_scale", "sensor", "sensor", _scale, "the sensor's readings are scaled", _apply_scale
)

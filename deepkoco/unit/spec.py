"""What a unit is: true parameters, hidden effects, sensor. Plain data that crosses to its process."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class SensorSpec:
    """How the unit is measured.

    Attributes:
        rate_hz: Samples per second.
        noise_sd: Standard deviation of the noise of each channel, in the channel's unit.
        quantisation: Step of each channel's reading, in its unit; 0 for none.
    """

    rate_hz: float
    noise_sd: tuple[float, ...]
    quantisation: tuple[float, ...]


@dataclass(frozen=True)
class UnitSpec:
    """One unit, complete: every parameter and every parameter of its hidden effects has a value.

    Attributes:
        name: Name of the unit, for messages and logs.
        system: Name of the system it is a unit of.
        parameters: True value of each of the system's parameters.
        effects: Hidden effects, effect name -> parameter -> value. A delay has ``delay`` [s] and
            ``jitter_sd`` [s], a push ``torque`` [N m], ``start`` [s] and ``duration`` [s].
        sensor: How it is measured.
        command_limits: Commands outside are cut to (low, high), in the command's unit.
        initial_state: Angle [rad] and speed [rad/s] at power-on.
        friction_smoothing: Speed [rad/s] over which dry friction changes sign; 0 for true sticking.
        heartbeat: Longest time without a command [s]; after it the command is set to zero.
        time_step: Longest integration step [s].
        seed: Seed of noise and jitter.
    """

    name: str
    system: str
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    sensor: SensorSpec
    command_limits: tuple[float, float]
    initial_state: tuple[float, float]
    friction_smoothing: float = 0.0
    heartbeat: float = 0.5
    time_step: float = 1e-3
    seed: int = 0

    def to_json(self) -> str:
        """The spec as one line of text."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(text: str) -> UnitSpec:
        """The spec back from :meth:`to_json`, equal to the one that was written."""
        content = json.loads(text)
        sensor = content.pop("sensor")
        return UnitSpec(
            **{
                **content,
                "sensor": SensorSpec(
                    sensor["rate_hz"], tuple(sensor["noise_sd"]), tuple(sensor["quantisation"])
                ),
                "command_limits": tuple(content["command_limits"]),
                "initial_state": tuple(content["initial_state"]),
            }
        )

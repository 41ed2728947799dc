"""Timing effects: delays and the actuator's first-order lag."""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.system import Parameter, System

LONGEST = 0.3  # [s]


def _actuation_delay(system: System) -> tuple[Parameter, ...]:
    return (Parameter("delay", 0.0, "s", 0.0, LONGEST, 0.05, "tau_a, command sent to command acting"),)


def _sensing_delay(system: System) -> tuple[Parameter, ...]:
    return (
        Parameter("delay", 0.0, "s", 0.0, LONGEST, 0.05, "tau_s, state to time stamp of its measurement"),
    )


def _lag(system: System) -> tuple[Parameter, ...]:
    return (Parameter("time_constant", 0.0, "s", 0.0, LONGEST, 0.05, "T, first-order lag of the actuator"),)


ACTUATION_DELAY = Effect(
    "actuation_delay", "timing", "timing", _actuation_delay, "commands act later than they are sent"
)
SENSING_DELAY = Effect(
    "sensing_delay", "timing", "timing", _sensing_delay, "measurements are older than their time stamps"
)
LAG = Effect("lag", "timing", "timing", _lag, "the actuator follows its command as a first-order lag")

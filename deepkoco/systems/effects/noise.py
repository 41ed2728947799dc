"""Noise effects: what changes how measurements scatter, not what they are expected to be."""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.parameter import Parameter
from deepkoco.systems.system import System


def _jitter(system: System, _: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("sd", 0.0, "s", 0.0, 0.1, 0.005, "standard deviation of the time stamps"),)


def _lost(system: System, command: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("share", 0.0, "1", 0.0, 1.0, 0.05, "share of the commands that never arrive"),)


def _level(system: System, channel: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("factor", 1.0, "1", 0.01, 100.0, 0.3, "noise per noise of the data sheet"),)


def _quantum(system: System, channel: int = 0) -> tuple[Parameter, ...]:
    declared = system.measurements[channel]
    limit = 1000.0 * declared.noise_sd
    return (
        Parameter("step", 0.0, declared.unit, 0.0, limit, declared.noise_sd, "step of the sensor's readings"),
    )


JITTER = Effect("jitter", "timing", "noise", _jitter, "time stamps of measurements scatter", site="system")
LOST_COMMANDS = Effect(
    "lost_commands", "timing", "noise", _lost, "commands are lost, and the one before is held", site="command"
)
NOISE_LEVEL = Effect(
    "noise_level", "sensor", "noise", _level, "a channel is noisier than its data sheet", site="channel"
)
QUANTISATION = Effect(
    "quantisation", "sensor", "noise", _quantum, "a channel is rounded to a coarse grid", site="channel"
)

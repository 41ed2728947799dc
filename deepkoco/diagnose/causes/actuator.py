"""Actuator causes: what happens to a command on its way to the joint."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint


def _largest(hint: Hint) -> float:
    return float(np.abs(hint.command).max())


def _gain_starts(hint: Hint) -> list[dict[str, float]]:
    return [{"gain.factor": factor} for factor in (0.6, 1.0, 1.6)]


def _dead_zone_starts(hint: Hint) -> list[dict[str, float]]:
    # At width 0 the gradient exists but misses commands that a wide zone swallows whole.
    return [{"dead_zone.width": share * _largest(hint)} for share in (0.0, 0.08, 0.3)]


def _saturation_starts(hint: Hint) -> list[dict[str, float]]:
    # The limit has no gradient until it cuts into the commands.
    return [{"saturation.limit": share * _largest(hint)} for share in (0.97, 0.8, 0.5)]


GAIN = Cause(
    "gain",
    "actuator",
    ("gain.factor",),
    "The actuator scales its command.",
    "Hold the joint at several constant commands and read the static angle: it gives the gain over the weight.",
    "command",
    lambda motion: motion.command,
    _gain_starts,
)
TORQUE_BIAS = Cause(
    "torque_bias",
    "actuator",
    ("torque_bias.effort",),
    "A constant effort adds to the command.",
    "Record the joint at rest at zero command, then at a second mounting angle.",
    "time",
    lambda motion: np.ones_like(motion.time),
)
DEAD_ZONE = Cause(
    "dead_zone",
    "actuator",
    ("dead_zone.width",),
    "Small commands have no effect.",
    "Use commands of many levels, small ones included; a bang-bang command cannot show a dead zone.",
    "command",
    lambda motion: -np.sign(motion.command),
    _dead_zone_starts,
)
SATURATION = Cause(
    "saturation",
    "actuator",
    ("saturation.limit",),
    "Large commands are cut off.",
    "Use commands of many levels up to the limit; a bang-bang command cannot show where it saturates.",
    "command",
    lambda motion: (
        -np.sign(motion.command)
        * np.maximum(np.abs(motion.command) - 0.7 * np.abs(motion.command).max(initial=0.0), 0.0)
    ),
    _saturation_starts,
)

"""Actuator causes: changes of the command between the log and the joint."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint
from deepkoco.diagnose.causes.units import UNIT_CONSTANTS, slip_starts


def _largest(hint: Hint) -> float:
    return float(np.abs(hint.command).max())


def _gain_starts(hint: Hint) -> list[dict[str, float]]:
    return [{"factor": factor} for factor in (0.6, 1.0, 1.6)]


def _dead_zone_starts(hint: Hint) -> list[dict[str, float]]:
    # The gradient at width 0 does not show the commands that a wide zone removes completely.
    return [{"width": share * _largest(hint)} for share in (0.0, 0.08, 0.3)]


def _saturation_starts(hint: Hint) -> list[dict[str, float]]:
    # The gradient is zero until the limit cuts the commands. If a command has only two levels, any limit below the
    # upper level cuts it at all times; only a limit just below it is a small enough step for the score test.
    return [{"limit": share * _largest(hint)} for share in (0.9999, 0.97, 0.8, 0.5)]


GAIN = Cause(
    "gain",
    "actuator",
    ("factor",),
    "The actuator scales its command.",
    "Hold the joint at several constant commands and read the static angles: they give the ratio of gain and weight.",
    "command",
    lambda motion: motion.command,
    _gain_starts,
)
DRIVE_STRENGTH = Cause(
    "drive_strength",
    "actuator",
    ("factor",),
    "The drive is weaker or stronger than its model: all of its force differs by one factor.",
    "Measure the supply voltage and the current of the stalled drive. Or hang a known weight on the joint and read by "
    "how much it gives way.",
    "command",
    lambda motion: motion.command,
    _gain_starts,
)
TORQUE_BIAS = Cause(
    "torque_bias",
    "actuator",
    ("effort",),
    "A constant effort adds to the command.",
    "Record the joint at rest at zero command, then at a second mounting angle.",
    "time",
    lambda motion: np.ones_like(motion.time),
)
DEAD_ZONE = Cause(
    "dead_zone",
    "actuator",
    ("width",),
    "Small commands have no effect.",
    "Use commands of many levels, including small ones; a command of two levels cannot show a dead zone.",
    "command",
    lambda motion: -np.sign(motion.command),
    _dead_zone_starts,
)
SATURATION = Cause(
    "saturation",
    "actuator",
    ("limit",),
    "Large commands are cut off.",
    "Use commands of many levels up to the limit; a command of two levels cannot show where it saturates.",
    "command",
    lambda motion: (
        -np.sign(motion.command)
        * np.maximum(np.abs(motion.command) - 0.7 * np.abs(motion.command).max(initial=0.0), 0.0)
    ),
    _saturation_starts,
)


def _backlash_starts(hint: Hint) -> list[dict[str, float]]:
    # The cost has a kink at every width at which the play covers one more reversal, so many close starts are needed.
    return [{"width": share * _largest(hint)} for share in np.geomspace(0.01, 0.3, 12)]


BACKLASH = Cause(
    "backlash",
    "actuator",
    ("width",),
    "There is play between command and effort: after a change of direction, the effort follows late.",
    "Sweep the command slowly up and down: with play, the efforts on the way up and on the way down differ.",
    "command",
    lambda motion: -np.sign(motion.command_rate),
    _backlash_starts,
)


def _rate_limit_starts(hint: Hint) -> list[dict[str, float]]:
    # Time in which the effort goes from zero to the largest command. No gradient shows a limit that limits nothing.
    starts = [{"limit": _largest(hint) / seconds} for seconds in (0.01, 0.03, 0.1, 0.3)]
    # A goal of the position that moves at a limited speed lets its joint move no faster.
    system, fastest = hint.system, float(np.abs(hint.omega).max(initial=0.0))
    units = {c.unit for c, j in zip(system.commands, system.command_joints, strict=False) if j == hint.joint}
    if fastest > 0.0 and system.state_units[hint.joint] in units:
        starts += [{"limit": share * fastest} for share in (0.6, 0.8, 1.0)]
    return starts


RATE_LIMIT = Cause(
    "rate_limit",
    "actuator",
    ("limit",),
    "The effort changes at a limited rate, so it follows a large change of the command later than a small one.",
    "Play steps of several sizes. Behind a limited rate the time to follow grows with the size; behind a lag it stays.",
    "command_rate",
    lambda motion: -motion.command_rate,
    _rate_limit_starts,
)
GAIN_DRIFT = Cause(
    "gain_drift",
    "actuator",
    ("rate",),
    "The actuator's gain drifts in time, as when it warms up.",
    "Repeat the same short sequence at the beginning and at the end of a long log.",
    "time",
    lambda motion: motion.command * (motion.time - motion.time.mean()),
)
GAIN_CURVE = Cause(
    "gain_curve",
    "actuator",
    ("curvature",),
    "The actuator's gain depends on the command: large commands have less (or more) than proportional effect.",
    "Hold the joint at constant commands of many levels up to the limit and read the static angles.",
    "command",
    lambda motion: motion.command**3,
)
ASYMMETRY = Cause(
    "asymmetry",
    "actuator",
    ("share",),
    "The actuator is stronger in one direction than in the other.",
    "Play a command sequence, then the same sequence with the opposite sign.",
    "command",
    lambda motion: np.abs(motion.command),
)
CROSSTALK = Cause(
    "crosstalk",
    "actuator",
    ("share",),
    "A share of one actuator's effort acts on another joint, through the gears, the cables or the wiring.",
    "Drive one actuator alone, hold the other joint, and measure the force there.",
    "command",
    lambda motion: motion.command,
)
TORQUE_SPEED_CURVE = Cause(
    "torque_speed_curve",
    "actuator",
    ("droop",),
    "The drive has less force the faster it pushes its joint: the back EMF of a motor takes a share of its voltage.",
    "Let the drive turn its joint freely at full command: it reaches the no-load speed. This is one over the droop "
    "where effort and load have one unit, else the load at standstill of one unit of effort, over the droop.",
    "omega",
    lambda motion: -np.sign(motion.command) * np.maximum(motion.command * motion.omega, 0.0),
)
UNIT_SLIP = Cause(
    "unit_slip",
    "unit",
    (),
    "The command in the log has the wrong unit: it differs from the true command by a conversion constant.",
    "Read the unit of the command in the driver's documentation and correct the sidecar.",
    "command",
    lambda motion: motion.command,
    slip_starts,
    choices=len(UNIT_CONSTANTS),
)

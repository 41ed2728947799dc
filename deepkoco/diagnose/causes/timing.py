"""Timing causes: delays, lag, clock skew, jitter and lost commands."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint, Motion
from deepkoco.diagnose.causes.tolerance import of_clock, of_sample, of_stamps
from deepkoco.diagnose.residuals.scatter import jitter
from deepkoco.systems import System
from deepkoco.systems.effects.timing import LONGEST

# Fits of a long delay from 0 stop in local minima, so they also start from longer delays [s].
STARTS = (0.0, 0.03, 0.08)
# Time from one command to the next for which these are meant [s]. Commands come less often where the machine is slower.
USUAL_INTERVAL = 0.01
LONGER = 1.5  # times the longest of them from which a start is another one


def _rate(motion: Motion) -> np.ndarray:
    return -motion.command_rate


def _all_others(system: System, channel: int) -> tuple[int, ...]:
    return tuple(c for c in range(len(system.measurements)) if c != channel)


def _positions(system: System, _: int) -> tuple[int, ...]:
    return tuple(c for c, state in enumerate(system.measured_states) if state < system.joints)


def _speeds(system: System) -> tuple[int, ...]:
    joints = system.joints
    return tuple(c for c, state in enumerate(system.measured_states) if joints <= state < 2 * joints)


def _starts(name: str):
    def starts(hint: Hint) -> list[dict[str, float]]:
        scaled = [hint.interval / USUAL_INTERVAL * value for value in STARTS]
        longer = [value for value in scaled if LONGER * STARTS[-1] < value < LONGEST]
        return [{name: value} for value in (*STARTS, *longer)]

    return starts


ACTUATION_DELAY = Cause(
    "actuation_delay",
    "timing",
    ("delay",),
    "Commands act later than they are sent.",
    "Log the time at which the motor current changes. Or move the joint by hand and compare with a second sensor: "
    "this shows a sensing delay, but not an actuation delay.",
    "command_rate",
    _rate,
    _starts("delay"),
    tolerance=of_sample,
)
SENSING_DELAY = Cause(
    "sensing_delay",
    "timing",
    ("delay",),
    "Measurements are older than their time stamps.",
    "Compare the sensor with a second one of known delay while the joint is moved by hand.",
    "command_rate",
    _rate,
    _starts("delay"),
    tolerance=of_sample,
)
CHANNEL_DELAY = Cause(
    "channel_delay",
    "timing",
    ("delay",),
    "The readings of one channel are older than those of the others.",
    "Move the robot by hand and compare the channel with another one that shows the same motion.",
    "command_rate",
    _rate,
    relative=_all_others,
    tolerance=of_sample,
)
SPEED_DELAY = Cause(
    "speed_delay",
    "timing",
    ("delay",),
    "The speeds are older than the positions, all by the same time: a drive differentiates its encoder and filters.",
    "Move the joints by hand and compare each speed with the slope of its position.",
    "command_rate",
    _rate,
    relative=_positions,
    several=_speeds,
    tolerance=of_sample,
)
LAG = Cause(
    "lag",
    "timing",
    ("time_constant",),
    "The actuator follows its command as a first-order lag.",
    "Record fast command steps at a sample time below the lag: a delay keeps a step's edge, a lag rounds it.",
    "command_rate",
    _rate,
    _starts("time_constant"),
    tolerance=of_sample,
)
CLOCK_SKEW = Cause(
    "clock_skew",
    "timing",
    ("rate",),
    "The clocks of commands and measurements run at different speeds, so the delay between them grows.",
    "Stamp both with one clock. Or record twice as long: the effect of a skew grows with the length of the log.",
    "command_rate",
    lambda motion: -motion.command_rate * (motion.time - motion.time.mean()),
    tolerance=of_clock,
)
STAMP_LEAD = Cause(
    "stamp_lead",
    "timing",
    ("lead",),
    "Commands act before their time stamps, so they are stamped late or the measurements early.",
    "Stamp each command when it is sent, and each measurement when it is taken, with one clock.",
    "command_rate",
    lambda motion: motion.command_rate,
    tolerance=of_stamps,
)
LOST_COMMANDS = Cause(
    "lost_commands",
    "timing",
    (),
    "Some commands never arrive, and the actuator holds the previous command.",
    "Number the commands and let the actuator log the numbers that it received.",
    "command_rate",
    lambda motion: -motion.command_rate,
    counted=1,
    traced=True,
)
JITTER = Cause(
    "jitter",
    "timing",
    (),
    "The time stamps of the measurements scatter.",
    "Stamp the measurements where they are made, with a hardware clock.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    scatter=jitter,
    counted=1,
    tolerance=of_sample,
)

"""Disturbances: constant loads, springs, and loads that are periodic in the angle of the joint or in time."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint

CYCLES = tuple(range(2, 31))  # per turn
MIN_CYCLES = 2.0  # cycles that a log must show
LOWEST = 0.8  # frequency from which an outside load is searched [rad/s]
LINES = 5  # lines of the spectrum that are tried


def _cycles(hint: Hint) -> list[dict[str, float]]:
    """Return the cycles per turn that the log shows twice; a pattern seen once may be a spring, a cable or a stop."""
    missing = hint.missing
    turned = np.inf
    if missing is not None:
        turned = max(float(np.ptp(missing.theta[missing.log == log])) for log in np.unique(missing.log))
    return [{"cycles": float(n)} for n in CYCLES if MIN_CYCLES * 2.0 * np.pi / n <= turned]


def _frequencies(hint: Hint) -> list[dict[str, float]]:
    """Return the strongest lines in the spectrum of the missing load, computed at its own times."""
    missing = hint.missing
    if missing is None:
        return []
    highest = 0.9 * np.pi / missing.slot
    # Lines of a log of length T are 2 pi / T apart.
    grid = np.arange(LOWEST, highest, max(1.5 / max(hint.seconds, 1.0), 0.02))
    t, load = missing.time.ravel(), missing.torque.ravel()
    wave = np.exp(-1j * np.outer(grid, t))
    power = np.abs(wave @ (load - load.mean()))
    found: list[float] = []
    for k in np.argsort(-power):
        if all(abs(grid[k] - f) > 6.0 / max(hint.seconds, 1.0) for f in found):
            found.append(float(grid[k]))
        if len(found) == LINES:
            break
    return [{"frequency": f} for f in found]


def _centres(hint: Hint) -> list[dict[str, float]]:
    """Return the zero of the joint, where springs are mounted, and the middle of the angles of the log.

    Without stiffness the data say nothing about the centre.
    """
    at_zero = {"centre": 0.0}
    return [at_zero] if hint.missing is None else [{"centre": float(hint.missing.theta.mean())}, at_zero]


CONSTANT_LOAD = Cause(
    "constant_load",
    "disturbance",
    ("load",),
    "A constant load acts on a joint: wind, the pull of a cable, a base that is not level.",
    "Let the joint come to rest, read its angle, and turn the whole machine round: a zero of the sensor turns with it.",
    "time",
    lambda motion: np.ones_like(motion.time),
)
SPRING = Cause(
    "spring",
    "disturbance",
    ("stiffness", "centre"),
    "A spring pulls the joint to a place: a cable, a hose, a gas spring or a counterweight on a lever.",
    "Hold the joint at several places without its motor and read the force: a spring's grows evenly with the way.",
    "theta",
    lambda motion: motion.theta.mean() - motion.theta,
    _centres,
    choices=2,  # at the zero of the joint, or anywhere
    shape=("centre",),
    natural=("centre",),
)
COGGING = Cause(
    "cogging",
    "actuator",
    ("sine", "cosine"),
    "A torque repeats several times per turn: the motor cogs, or a gear is off centre.",
    "Turn the joint slowly by hand and feel for detents; count them over a turn.",
    "theta",
    lambda motion: np.zeros_like(motion.time),
    _cycles,
    choices=len(CYCLES),
)
PERIODIC = Cause(
    "periodic",
    "actuator",
    ("sine", "cosine", "frequency"),
    "A load from outside is periodic in time.",
    "Find the device that runs at this frequency (a fan, a pump, another axis), switch it off and record again.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    _frequencies,
    choices=200,
    shape=("frequency",),
)

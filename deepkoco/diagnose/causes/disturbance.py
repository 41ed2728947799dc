"""Disturbances: loads that come back with the angle of the joint or in time."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint

CYCLES = tuple(range(2, 49))  # per turn
LOWEST, HIGHEST = 0.8, 90.0  # frequencies that are searched [rad/s]


def _cycles(hint: Hint) -> list[dict[str, float]]:
    return [{"cycles": float(n)} for n in CYCLES]


def _frequencies(hint: Hint) -> list[dict[str, float]]:
    # Lines of a log of length T are about 2 pi / T apart; windows have states of their own, so that coarser will do.
    spacing = max(2.5 / max(hint.seconds, 1.0), 0.08)
    count = min(int((HIGHEST - LOWEST) / spacing), 240)
    return [{"frequency": float(f)} for f in np.linspace(LOWEST**0.5, HIGHEST**0.5, count) ** 2]


COGGING = Cause(
    "cogging",
    "actuator",
    ("sine", "cosine"),
    "A torque comes back every part of a turn: the motor cogs, or a gear is off centre.",
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
    "An outside load comes back in time.",
    "Look for what runs at that frequency (a fan, a pump, another axis), and record with it off.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    _frequencies,
    choices=240,
)

"""Disturbances: constant loads, springs, and loads that are periodic in the angle of the joint or in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint
from deepkoco.systems.effects.disturbance import PITCHES

if TYPE_CHECKING:
    from deepkoco.diagnose.residuals.residuals import MissingTorque
    from deepkoco.diagnose.residuals.waves import Answers, Waves

CYCLES = tuple(range(2, 31))  # per turn
MIN_CYCLES = 2.0  # cycles that a log must show
MOST_SHOWN = 60.0  # cycles on the way of a slide that are tried
LOWEST = 0.8  # frequency from which an outside load is searched [rad/s]
NEARLY = 0.9  # share of what the best pitch explains from which another one is tried
HALVINGS = 3  # of the windows in which pitches are sought
LINES = 5  # lines of the spectrum that are tried


def _cycles(hint: Hint) -> list[dict[str, float]]:
    """Return the cycles per turn that the log shows twice; a pattern seen once may be a spring, a cable or a stop.

    Poles of a linear motor or threads of a screw have any pitch. Those that are tried for a slide are half a cycle on
    its way apart.
    """
    missing = hint.missing
    turned = np.inf
    if missing is not None:
        turned = max(float(np.ptp(missing.theta[missing.log == log])) for log in np.unique(missing.log))
    if hint.system.state_units[hint.joint] == "m":
        return _pitches(missing, turned) if missing is not None and turned > 0.0 else []
    return [{"cycles": float(n)} for n in CYCLES if MIN_CYCLES * 2.0 * np.pi / n <= turned]


def _pitches(missing: MissingTorque, way: float) -> list[dict[str, float]]:
    """Return the pitches that explain nearly as much of the residuals as the best one, each with its size and phase.

    They are sought in windows of the length in which one of them stands out most: a detent that is missing moves the
    simulation by more than its response tells within a long one.
    """
    counts = np.arange(MIN_CYCLES, MOST_SHOWN, 0.5)
    counts = counts[(way / counts >= PITCHES[0]) & (way / counts <= PITCHES[1])]
    if missing.waves is None or len(counts) == 0:
        return []
    clearest, falls = 0.0, np.zeros(len(counts))
    shorter: Waves | None = missing.waves
    chosen: Answers | None = None
    for _ in range(HALVINGS + 1):
        if shorter is None:
            break
        answers = shorter.answering()
        there, _ = answers.explained(2.0 * np.pi * counts / way)
        best = int(there.argmax())
        others = there[abs(counts - counts[best]) > 1.0]
        clear = float(there[best]) / max(float(others.max(initial=0.0)), 1e-300)
        if chosen is None or clear > clearest:
            clearest, chosen, falls = clear, answers, there
        shorter = shorter.halved()
    assert chosen is not None
    coarse: list[int] = []
    for k in np.argsort(-falls):
        if all(abs(counts[k] - counts[other]) > 1.0 for other in coarse):
            coarse.append(int(k))
        if len(coarse) == LINES:
            break
    # A fit finds a pitch only from within a fraction of a cycle on the whole way.
    near = np.linspace(-0.45, 0.45, 10)
    counts = np.concatenate([counts[k] + near for k in coarse])
    falls, sizes = chosen.explained(2.0 * np.pi * counts / way)
    best = falls.reshape(-1, len(near)).argmax(1)
    found = [k for k in len(near) * np.arange(len(best)) + best if falls[k] >= NEARLY * falls.max()]
    return [
        {"pitch": float(way / counts[k]), "sine": float(sizes[k, 0]), "cosine": float(sizes[k, 1])}
        for k in found
    ]


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
    shape=("pitch",),
    also=("pitch",),
    also_summary="A force repeats along the way: poles of a linear motor, teeth of a rack, turns of a screw.",
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

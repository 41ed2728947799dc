"""Excitations by name. A new excitation is one file in this folder and one line in `EXCITATIONS`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator

from deepkoco.excitation.bang_bang import bang_bang
from deepkoco.excitation.chirp import chirp
from deepkoco.excitation.signal import Excitation, ExcitationError, natural_frequency
from deepkoco.excitation.steps import prbs, steps
from deepkoco.systems import System, one_joint


def make_excitation(
    kind: str, system: str, seconds: float, seed: int = 0, amplitude: float | None = None
) -> Excitation:
    """Make an excitation for a system; its time scale is the natural period of the system.

    Args:
        kind: One of :data:`EXCITATIONS`.
        system: Name of the system.
        seconds: Length of the log [s].
        seed: Seed of the draws of the excitation.
        amplitude: Largest command, in the command's unit; None takes the system's limit.

    Raises:
        ExcitationError: There is no such excitation, the amplitude is outside the limits, or the seed is
            negative.
    """
    if kind not in EXCITATIONS:
        raise ExcitationError(f'unknown excitation "{kind}"; known: {", ".join(EXCITATIONS)}')
    physics = one_joint(system)
    limit, unit = physics.command.high, physics.command.unit
    size = limit if amplitude is None else amplitude
    if not 0.0 < size <= limit:
        raise ExcitationError(f"amplitude {size:g} {unit} is outside (0, {limit:g}] {unit} of {system}")
    if seed < 0:
        raise ExcitationError(f"seed {seed} is negative; give 0 or more")
    generator = np.random.default_rng([seed, sorted(EXCITATIONS).index(kind)])
    excitation = EXCITATIONS[kind](physics, seconds, size, generator)
    return _speed_guard(excitation, size, natural_frequency(physics))


def _speed_guard(excitation: Excitation, amplitude: float, frequency: float) -> Excitation:
    """Brake with full amplitude when the speed exceeds 3 natural frequencies, until it is below 2.

    A pendulum that falls from the top reaches 2 natural frequencies. Without the guard, a resonant or strong command
    makes the pendulum rotate fast, and the effect of gravity then averages out.
    """
    braking = False

    def command(t: float, measurement: Sequence[float]) -> float:
        nonlocal braking
        speed = measurement[1]
        braking = abs(speed) > (2.0 if braking else 3.0) * frequency
        return math.copysign(amplitude, -speed) if braking else excitation(t, measurement)

    return command


EXCITATIONS: dict[str, Callable[[System, float, float, Generator], Excitation]] = {
    "chirp": chirp,
    "steps": steps,
    "prbs": prbs,
    "bang-bang": bang_bang,
}

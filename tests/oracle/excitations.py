"""Commands of the hidden units: open loop (steps, chirp), closed loop, and two-level."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from deepkoco.excitation.excitation import make_excitation
from deepkoco.excitation.signal import natural_frequency
from deepkoco.systems import JOINT_SYSTEMS, System

EXCITATIONS = ("steps", "chirp", "closed-loop", "bang-bang")
Wanted = Callable[[float, Sequence[float]], list[float]]


class Drive:
    """Commands from time and the latest reading.

    Attributes:
        start: Coordinates at the beginning.
        rest: Commands that act before the first one comes.
    """

    def __init__(self, start: Sequence[float], rest: Sequence[float], wanted: Wanted) -> None:
        self.start, self.rest, self._wanted = tuple(start), tuple(rest), wanted

    def __call__(self, t: float, reading: Sequence[float]) -> list[float]:
        return self._wanted(t, reading)


def make_drive(kind: str, system: System, seconds: float, seed: int) -> Drive:
    """Excitation of a system by name."""
    rng = np.random.default_rng([seed, 4, EXCITATIONS.index(kind)])
    if system.name in JOINT_SYSTEMS:
        return _pendulum(kind, system, seconds, seed, rng)
    return _arm(kind, system, seconds, rng) if system.joints == 2 else _height(kind, seconds, rng)


def _pendulum(kind: str, system: System, seconds: float, seed: int, rng: np.random.Generator) -> Drive:
    hanging = system.upright + math.pi  # type: ignore[attr-defined]
    if kind != "closed-loop":
        act = make_excitation(kind, system.name, seconds, seed)
        return Drive([hanging], [0.0], lambda t, y: [act(t, y)])
    frequency, limit = natural_frequency(system), system.commands[0].high
    aim = _held(rng, seconds, lambda: rng.uniform(-1.2, 1.2), 0.6 / frequency, 6.0 / frequency)

    def follow(t: float, y: Sequence[float]) -> list[float]:
        return [limit * (1.5 * (hanging + aim(t) - y[0]) - 0.6 * y[1] / frequency)]

    return Drive([hanging], [0.0], follow)


def _arm(kind: str, system: System, seconds: float, rng: np.random.Generator) -> Drive:
    limits = [c.high for c in system.commands]
    start = [float(x) for x in rng.uniform(-1.0, 1.0, 2)]
    if kind == "chirp":
        phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        signals: list[Callable[[float], float]] = [
            lambda t, p=p, f=f: math.sin(f * t + 0.15 * t * t * math.pi / 10.0 + p)
            for p, f in zip(phase, (1.6, 2.3), strict=True)
        ]
    else:
        levels = (-1.0, 1.0) if kind == "bang-bang" else np.linspace(-1.0, 1.0, 9)
        signals = [_held(rng, seconds, lambda: rng.choice(levels), 0.15, 0.9) for _ in limits]
    if kind != "closed-loop":
        # Turned back where a joint gets fast: whirling hides everything else.
        def act(t: float, y: Sequence[float]) -> list[float]:
            free = [limit * s(t) for limit, s in zip(limits, signals, strict=True)]
            fast = [abs(v) > 5.0 for v in y[2:]]
            brake = [-math.copysign(limit, v) for limit, v in zip(limits, y[2:], strict=True)]
            return [b if f else u for u, b, f in zip(free, brake, fast, strict=True)]

        return Drive(start, [0.0, 0.0], act)

    def follow(t: float, y: Sequence[float]) -> list[float]:
        return [
            limit * (2.0 * (1.5 * s(t) - q) - 0.5 * v)
            for limit, s, q, v in zip(limits, signals, y[:2], y[2:], strict=True)
        ]

    return Drive(start, [0.0, 0.0], follow)


def _height(kind: str, seconds: float, rng: np.random.Generator) -> Drive:
    hover = 0.033 * 9.81
    aim = _held(rng, seconds, lambda: rng.uniform(-0.8, 0.8), 0.5, 2.0)
    shake = _held(rng, seconds, lambda: rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0]), 0.06, 0.4)
    phase = float(rng.uniform(0.0, 2.0 * math.pi))

    def act(t: float, y: Sequence[float]) -> list[float]:
        # A height that nothing holds runs away: every excitation rides on a slow loop.
        held = 0.10 * (aim(t) - y[0]) - 0.08 * y[1]
        if kind == "bang-bang":
            return [hover + math.copysign(0.16, held)]
        if kind == "chirp":
            return [hover + held + 0.12 * math.sin(2.0 * t + 0.25 * t * t + phase)]
        return [hover + held + (0.12 * shake(t) if kind == "steps" else 0.0)]

    return Drive([0.0], [hover], act)


def _held(
    rng: np.random.Generator, seconds: float, draw: Callable[[], float], shortest: float, longest: float
) -> Callable[[float], float]:
    """Piecewise constant signal with random levels and lengths."""
    ends, values = [0.0], []
    while ends[-1] <= seconds:
        values.append(float(draw()))
        ends.append(ends[-1] + float(rng.uniform(shortest, longest)))
    switches = np.array(ends[:-1])
    return lambda t: values[max(int(np.searchsorted(switches, t, side="right")) - 1, 0)]

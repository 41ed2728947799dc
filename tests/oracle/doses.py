"""Doses of every hidden effect, and the strength ES that they have in a log."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.causes import catalogue
from deepkoco.fit import Noise, cut_windows, moving, window_length
from deepkoco.logs.recording import Recording
from deepkoco.systems import System, make_system
from tests.oracle.unit import Hidden, hidden_log

# Dose x -> parameters, from the load scale [N m or N], the largest command and the time scale [s] of a joint; doses
# are such that x = 1 is visible.
Dose = Callable[[float, float, float, float], dict[str, float]]
INVISIBLE = 0.01  # ES below which a dose does nothing that the log shows
DOSES: dict[str, Dose] = {
    "actuation_delay": lambda x, load, command, time: {"delay": 0.01 * time * x},
    "sensing_delay": lambda x, load, command, time: {"delay": 0.01 * time * x},
    "lag": lambda x, load, command, time: {"time_constant": 0.01 * time * x},
    "lost_commands": lambda x, load, command, time: {"share": min(0.01 * x, 0.5)},
    "clock_skew": lambda x, load, command, time: {"rate": 5e-4 * x},
    "viscous": lambda x, load, command, time: {"change": 0.02 * x * load * time},
    "coulomb": lambda x, load, command, time: {"torque": 0.01 * x * load},
    "stribeck": lambda x, load, command, time: {
        "coulomb": 0.002 * x * load,
        "breakaway": 0.03 * x * load,
        "speed": 0.1 / time,
    },
    "quadratic": lambda x, load, command, time: {"drag": 0.01 * x * load * time**2},
    "load_friction": lambda x, load, command, time: {"coefficient": 0.02 * x * load / command},
    "torque_speed_curve": lambda x, load, command, time: {"droop": 0.05 * x * time},
    "gain": lambda x, load, command, time: {"factor": 1.0 / (1.0 + 0.1 * x)},
    "torque_bias": lambda x, load, command, time: {"effort": 0.02 * x * command},
    "dead_zone": lambda x, load, command, time: {"width": 0.03 * x * command},
    "backlash": lambda x, load, command, time: {"width": 0.03 * x * command},
    "saturation": lambda x, load, command, time: {"limit": command / (1.0 + 0.1 * x)},
    "gain_curve": lambda x, load, command, time: {"curvature": -0.1 * x / command**2},
    "gain_drift": lambda x, load, command, time: {"rate": 0.003 * x},
    "asymmetry": lambda x, load, command, time: {"share": 0.02 * x},
    "cogging": lambda x, load, command, time: {
        "sine": 0.02 * x * load,
        "cosine": 0.01 * x * load,
        "cycles": 7.0,
    },
    "periodic": lambda x, load, command, time: {
        "sine": 0.01 * x * load,
        "cosine": 0.01 * x * load,
        "frequency": 2.7 / time,
    },
    "payload": lambda x, load, command, time: {"mass": 0.03 * x * load / 9.81},
    "length": lambda x, load, command, time: {"factor": 1.0 + 0.02 * x},
    "sensor_bias": lambda x, load, command, time: {"angle": 0.005 * x},
    "sensor_scale": lambda x, load, command, time: {"factor": 1.0 + 0.002 * x},
    "sensor_drift": lambda x, load, command, time: {"rate": 3e-4 * x},
    "low_pass": lambda x, load, command, time: {"time_constant": 0.01 * time * x},
    "event": lambda x, load, command, time: {"torque": 0.1 * x * load, "start": 7.3, "duration": 0.2},
}
# Viscous friction that differs between directions has none: it would drive a joint without friction, as that of the rod
# pendulum, one way, which no friction does.
# What no cause of the catalogue is.
OUTSIDE: dict[str, Dose] = {
    "turbulence": lambda x, load, command, time: {"size": 0.01 * x * load},
    "position_friction": lambda x, load, command, time: {"size": 0.02 * x * load * time},
    "tether": lambda x, load, command, time: {"stiffness": 0.02 * x * load},
}
# Present in every log of the condition "floor", healthy ones included: (system's effect, dose).
FLOOR: tuple[tuple[str, float], ...] = (
    ("lag", 0.4),
    ("load_friction", 0.5),
    ("torque_bias", 0.15),
    ("gain_drift", 0.2),
)


def effect_names(system: str) -> tuple[str, ...]:
    """Causes of the catalogue, at their sites, of which there are doses."""
    known = catalogue(make_system(system))
    found = [name for name, cause in known.items() if cause.kind in DOSES]
    # A zero error that nothing depends on cannot be seen.
    return tuple(n for n in found if not (system == "quadrotor_height" and n == "sensor_bias"))


def outside_names(system: str) -> tuple[str, ...]:
    """What no cause of the catalogue is, of which there are doses and which differs from what a cause is."""
    # Over the little way that a height varies, friction that follows the position is viscous friction.
    return tuple(
        sorted(n for n in OUTSIDE if not (system == "quadrotor_height" and n == "position_friction"))
    )


def dosed(name: str, system: str, x: float) -> dict[str, dict[str, float]]:
    """What is hidden by a dose of one effect."""
    physics = make_system(system)
    kind = name.split("(")[0]
    joint = int(name.split("joint ")[1].rstrip(")")) - 1 if "joint " in name else 0
    dose = DOSES.get(kind) or OUTSIDE[kind]
    return {name: dose(x, physics.load_scales[joint], physics.commands[joint].high, _time(physics))}


def outside(name: str, system: str, x: float) -> dict[str, dict[str, float]]:
    """As :func:`dosed`, at the first joint of a system of several."""
    return dosed(name if make_system(system).joints == 1 else f"{name}(joint 1)", system, x)


def _time(system: System) -> float:
    return {"pendulum": 0.1, "two_link_arm": 0.5}.get(system.name, 0.3)


def unexplained(recording: Recording, system: str) -> tuple[float, int]:
    """Cost that the refitted baseline leaves (its distance from its priors included), and samples.

    Infinite for a log in which nothing moves: no effect that can be diagnosed is so strong.
    """
    base = make_system(system)
    noise = tuple(Noise(c.noise_sd, 0.0) for c in base.measurements)
    windows = cut_windows([recording], base, window_length(base), noise)
    windows = windows.take(moving(windows))
    if len(windows) == 0:
        return math.inf, 1
    return refit(baseline_from(base, windows), windows).cost, windows.samples


def strength(
    system: str, hidden: Hidden, excitation: str, seed: int, seconds: float, healthy: float
) -> float:
    """ES on a noise-free log: root mean square of what the refit leaves, in noise standard deviations.

    Args:
        system: Name of the system.
        hidden: Effects.
        excitation: Name of the excitation.
        seed: Seed of the unit.
        seconds: Length of the log [s].
        healthy: Cost per sample that the refit leaves on the same unit without the effect.
    """
    cost, samples = unexplained(hidden_log(system, hidden, excitation, seed, seconds, noisy=False), system)
    return math.sqrt(max(cost / samples - healthy, 0.0))


def scaled(
    make: Callable[[float], Hidden], system: str, excitation: str, seed: int, seconds: float, wanted: float
) -> tuple[Hidden, float]:
    """Effects at about the wanted strength, and the strength that they really have."""
    cost, samples = unexplained(hidden_log(system, make(0.0), excitation, seed, seconds, noisy=False), system)
    dose, found, hidden = 1.0, 0.0, make(1.0)
    for _ in range(4):
        hidden = make(dose)
        found = strength(system, hidden, excitation, seed, seconds, cost / samples)
        if 0.75 * wanted < found < 1.33 * wanted:
            break
        if found < INVISIBLE and dose > 1.0:
            # Acting where the log shows nothing, as a push on a joint at rest, it would only grow out of all bounds.
            hidden = make(1.0)
            return hidden, strength(system, hidden, excitation, seed, seconds, cost / samples)
        dose *= float(np.clip(wanted / max(found, 1e-3), 0.05, 8.0))
    return hidden, found

"""How a method that only moves parameters says what is wrong: the change that is largest in its usual scale.

The units of the benchmark differ from their data sheet by up to 3 %. So a change is taken for a cause from 4 % on: of
the value for masses, inertias and gains, of the joint's load for friction, loads and springs. Where there are healthy
logs, a change is taken from the fit to these.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch

from deepkoco.systems import Motion, System
from experiments.studies.diagnosis.hidden_cause.kinds import NOTHING

USUAL = 0.04
DELAY, ANGLE, WAY = 0.004, 0.02, 0.005  # [s, rad, m]
SPEED = {"rad": 2.0, "m": 1.0}  # at which a viscous friction is compared with the load [rad/s, m/s]


def load_of(system: System, joint: int) -> float:
    """Torque or force with which missing ones at a joint are compared [N m or N]."""
    share = 0.3 if system.state_units[joint] == "m" else 1.0  # a cart is driven with a fraction of its weight
    return share * system.load_scales[joint]


def inertias(system: System) -> list[float]:
    """Inertia (J) that each joint feels with the others free [kg m2 or kg]."""
    zero = torch.zeros((), dtype=torch.float64)
    motion = Motion((zero,) * system.joints, (zero,) * system.joints, (zero,) * len(system.commands))
    inverse = system.inverse_inertia(system.default_parameters())(motion)
    return [1.0 / float(inverse[j][j]) for j in range(system.joints)]


def usual_scale(system: System, name: str, value: float, prior_sd: float) -> float:
    """Change of a parameter from which it is taken for a cause, in its unit.

    Args:
        system: The model as given.
        name: The parameter, ``damping(j1)`` or of an effect, ``actuation_delay(j1).delay``.
        value: As given.
        prior_sd: Of its prior; the scale of a parameter of another sort.
    """
    kind, _, rest = name.partition("(")
    kind, place = kind.partition(".")[0], rest.partition(")")[0]
    joint = list(system.joint_names).index(place) if place in system.joint_names else 0
    unit, load = system.state_units[joint], load_of(system, joint)
    scales = {
        "damping": USUAL * load / SPEED[unit],
        "viscous": USUAL * load / SPEED[unit],
        "frictionloss": USUAL * load,
        "coulomb": USUAL * load,
        "torque_bias": USUAL * load,
        "spring": USUAL * load / (1.0 if unit == "rad" else 0.3),
        "actuation_delay": DELAY,
        "sensing_delay": DELAY,
        "sensor_bias": ANGLE if unit == "rad" else WAY,
    }
    if kind in scales:
        return scales[kind]
    if kind == "armature":
        return USUAL * inertias(system)[joint]
    if kind.startswith(("com_", "pos_")) or value == 0.0:
        return prior_sd
    return USUAL * abs(value)


def first_name(
    system: System,
    before: Mapping[str, float],
    after: Mapping[str, float],
    prior_sd: Mapping[str, float],
    interval: Mapping[str, float] | None = None,
) -> str:
    """Return the cause that the largest change stands for; "nothing" where none is larger than usual.

    Args:
        system: The model as given.
        before: Parameters as given, or fitted to healthy logs.
        after: Parameters fitted to the log.
        prior_sd: Of each.
        interval: Half of its 95 % interval; a change within it counts as none.
    """
    sizes = {}
    for name in after:
        change = abs(after[name] - before[name])
        if interval is None or change > interval[name]:
            sizes[name] = change / usual_scale(system, name, before[name], prior_sd[name])
    best = max(sizes, key=lambda n: sizes[n], default="")
    if not best or sizes[best] < 1.0:
        return NOTHING
    return best.rsplit(".", 1)[0] if "." in best else f"changed({best})"

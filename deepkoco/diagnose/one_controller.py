"""Gains of one controller: where a search for sizes puts the damping of a servo.

A servo has damping within its force limit, the rate gain kv of its controller, and beyond it, the damping of its joint
with the back EMF of its motor. Only saturation tells them apart, so a coarse search takes either. The gains kp and kv
are numbers of one firmware, turned into a torque by one supply, one motor and one gear: where the stiffness is a
seventieth of the model's, a fit therefore starts from a rate gain that is one too, and from the rest as damping of the
joint. It is a start and no prior: a log with saturation moves the damping to where it belongs.

Source: Duclusaud et al., Extended friction models for the physics simulation of servo actuators (2024), II: one gain
from the error to the voltage; the back EMF acts outside of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.systems.trees import TreeSystem


def with_surplus_as_damping(declared: Baseline, values: Mapping[str, float]) -> dict[str, float]:
    """Return values with rate gains in proportion to the stiffnesses, and what these lose as damping of the joints.

    A servo moves alike under both where it does not saturate. A joint without a damping in its model keeps its kv,
    which then stands for that as well.

    Args:
        declared: The baseline with its prior as declared.
        values: All parameters.
    """
    result = dict(values)
    for servo in _servos(declared):
        kept = declared.values[servo.rate] * values[servo.stiffness] / declared.values[servo.stiffness]
        p, had = declared.system.parameter(servo.damping), result[servo.damping]
        damping = float(np.clip(had + servo.square * (values[servo.rate] - kept), p.low, p.high))
        result |= {servo.damping: damping, servo.rate: values[servo.rate] - (damping - had) / servo.square}
    return result


class _Servo(NamedTuple):
    stiffness: str
    rate: str
    damping: str  # of its joint
    square: float  # of the gear: damping of the joint per rate gain


def _servos(declared: Baseline) -> Iterator[_Servo]:
    """Names of the gains of each servo whose joint has a damping of its own."""
    base, free = declared.system.base, set(declared.prior.names)
    for actuator in base.tree.actuators if isinstance(base, TreeSystem) else ():
        own = _Servo(
            f"kp({actuator.name})",
            f"kv({actuator.name})",
            f"damping({base.joint_names[actuator.joint]})",
            actuator.gear**2,
        )
        if {own.stiffness, own.rate, own.damping} <= free:
            yield own

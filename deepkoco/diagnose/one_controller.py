"""Gains of one controller: what a servo multiplies its errors with changes for position and speed alike.

The gains kp and kv of a servo are numbers of one firmware, turned into a torque by one supply, one motor and one gear.
If the model's stiffness is far off, so is this conversion, and the rate gain with it: what is known of it is the time
kv / kp. Otherwise a model whose kp is seventy times too large would let kv alone keep its size, and it would take over
the friction and the back EMF of the whole drive. A log tells the two apart only where the servo saturates: kv is cut
off there with the stiffness, the damping of the joint is not.

Source: Duclusaud et al., Extended friction models for the physics simulation of servo actuators (2024), II: one gain
from the error to the voltage; the back EMF acts outside of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.one_make import FAR, LEAST
from deepkoco.systems.trees import TreeSystem


def with_gains_tied(
    declared: Baseline,
    names: Sequence[str],
    values: Mapping[str, float],
    settled: bool,
    covariance: np.ndarray,
) -> np.ndarray:
    """Return a prior covariance in which the rate gain of a servo follows its stiffness.

    A servo of which a settled fit, made under such a prior, has another time kv / kp all the same keeps its own prior.
    So does one whose joint has no damping in the model: there kv stands for that as well.

    Args:
        declared: The baseline with its prior as declared.
        names: (p,) parameters.
        values: Their values in a fit.
        settled: Whether this fit was made under such a prior.
        covariance: (p, p) around the values as given.
    """
    follows, own = np.eye(len(names)), np.zeros(len(names))
    spread = dict(zip(declared.prior.names, np.sqrt(declared.prior.covariance.diagonal()), strict=True))
    for servo in _servos(declared, names):
        kp, kv = declared.values[servo.stiffness], declared.values[servo.rate]
        sd = spread[servo.rate] * max(abs(values[servo.stiffness] / kp), LEAST)
        if settled and abs(values[servo.rate] - kv * values[servo.stiffness] / kp) > FAR * sd:
            continue
        i, j = names.index(servo.stiffness), names.index(servo.rate)
        follows[j], own[j] = 0.0, sd**2
        follows[j, i] = kv / kp
    return follows @ covariance @ follows.T + np.diag(own)


def with_surplus_as_damping(declared: Baseline, values: Mapping[str, float]) -> dict[str, float]:
    """Return values with rate gains in proportion to the stiffnesses, and what these lose as damping of the joints.

    A servo moves alike under both where it does not saturate, so a search takes either. Which one it took must not
    decide how large the others of its make are thought to be.

    Args:
        declared: The baseline with its prior as declared.
        values: All parameters.
    """
    result = dict(values)
    for servo in _servos(declared, declared.prior.names):
        kept = declared.values[servo.rate] * values[servo.stiffness] / declared.values[servo.stiffness]
        p, had = declared.system.parameter(servo.damping), values[servo.damping]
        damping = float(np.clip(had + servo.square * (values[servo.rate] - kept), p.low, p.high))
        result |= {servo.damping: damping, servo.rate: values[servo.rate] - (damping - had) / servo.square}
    return result


class _Servo(NamedTuple):
    stiffness: str
    rate: str
    damping: str  # of its joint
    square: float  # of the gear: damping of the joint per rate gain


def _servos(declared: Baseline, names: Sequence[str]) -> Iterator[_Servo]:
    """Names of the gains of each servo whose joint has a damping of its own."""
    base = declared.system.base
    for actuator in base.tree.actuators if isinstance(base, TreeSystem) else ():
        own = _Servo(
            f"kp({actuator.name})",
            f"kv({actuator.name})",
            f"damping({base.joint_names[actuator.joint]})",
            actuator.gear**2,
        )
        if {own.stiffness, own.rate} <= set(names) and own.damping in declared.prior.names:
            yield own

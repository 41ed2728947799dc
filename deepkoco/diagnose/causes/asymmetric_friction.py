"""Friction that differs between the two directions of a joint, as a cause."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause
from deepkoco.diagnose.causes.tolerance import share_at_speed

ASYMMETRIC_VISCOUS = Cause(
    "asymmetric_viscous",
    "friction",
    ("difference",),
    "Viscous friction is larger in one direction than in the other.",
    "Move the joint at several constant speeds, each in both directions, and compare the efforts. A bias adds the same "
    "at every speed, an actuator that is stronger one way a share of its effort; this friction grows with the speed.",
    "omega",
    lambda motion: -0.5 * np.abs(motion.omega),
    tolerance=share_at_speed(1),
)

"""Body causes: what the robot is made of and carries."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint


def _starts(hint: Hint) -> list[dict[str, float]]:
    return [{"payload.mass": share * hint.system.load_scale / 9.81} for share in (0.0, 0.1)]


PAYLOAD = Cause(
    "payload",
    "body",
    ("payload.mass",),
    "A point mass is fixed to the tip.",
    "Weigh the tip, or hold it at rest at several angles and read the static command.",
    "theta",
    lambda motion: np.sin(motion.theta),
    _starts,
)

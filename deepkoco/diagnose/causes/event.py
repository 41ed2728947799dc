"""Events: something outside acted on the joint for a while."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint


def _starts(hint: Hint) -> list[dict[str, float]]:
    return [dict(push) for push in hint.pushes]


EVENT = Cause(
    "event",
    "event",
    ("torque", "start", "duration"),
    "Something outside pushed the joint for a while.",
    "Look at the video or the lab book at that time; repeat the log and see whether it comes back.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    _starts,
    searched=True,
)

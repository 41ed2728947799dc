"""Events: something outside acted on the joint for a while."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint
from deepkoco.fit.simulate.push import LONGEST, SHORTEST

STRETCHES = (0.4, 0.6, 0.8, 0.9, 1.1, 1.25, 1.6, 2.5)


def _starts(hint: Hint) -> list[dict[str, float]]:
    return [dict(push) for push in hint.pushes]


def _stretched(values: Mapping[str, float]) -> list[dict[str, float]]:
    """Pushes of the same impulse about the same time: short and hard, long and soft. They look almost alike."""
    torque, start, duration = (values[f"event.{n}"] for n in ("torque", "start", "duration"))
    found = []
    for factor in STRETCHES:
        lasts = min(max(factor * duration, SHORTEST), LONGEST)
        begins = start + 0.5 * (duration - lasts)
        found.append(
            {"event.torque": torque * duration / lasts, "event.start": begins, "event.duration": lasts}
        )
    return found


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
    valley=_stretched,
)

"""Push (event): a load from outside acts on the joint for a short time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint
from deepkoco.diagnose.causes.tolerance import of_impulse
from deepkoco.fit.simulate.push import LONGEST, SHORTEST

STRETCHES = (0.4, 0.6, 0.8, 0.9, 1.1, 1.25, 1.6, 2.5)


def _starts(hint: Hint) -> list[dict[str, float]]:
    return [dict(push) for push in hint.pushes]


def _stretched(values: Mapping[str, float]) -> list[dict[str, float]]:
    """Return pushes of the same impulse around the same time, shorter or longer; they fit almost equally well."""
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
    "Something outside pushed the joint for a short time.",
    "Look at the video or the lab book at that time. Repeat the log and check whether the push occurs again.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    _starts,
    searched=True,
    valley=_stretched,
    shape=("start", "duration"),
    tolerance=of_impulse,
)

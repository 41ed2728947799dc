"""Push: for a short time, a load from outside acts on a joint (event), or a force at a body."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint
from deepkoco.diagnose.causes.tolerance import of_force_impulse, of_impulse
from deepkoco.fit.simulate.push import LONGEST, SHORTEST, Push
from deepkoco.systems.motion import POINT

ADVICE = (
    "Look at the video or the lab book at that time. Repeat the log and check whether the push occurs again."
)
STRETCHES = (0.4, 0.6, 0.8, 0.9, 1.1, 1.25, 1.6, 2.5)


def _starts(hint: Hint) -> list[dict[str, float]]:
    return [dict(push) for push in hint.pushes]


def _stretched(values: Mapping[str, float]) -> list[dict[str, float]]:
    """Return pushes of the same impulse around the same time, shorter or longer; they fit almost equally well."""
    start, duration = values["event.start"], values["event.duration"]
    sizes = {n: values[n] for n in Push.SIZES if values.get(n, 0.0)}
    found = []
    for factor in STRETCHES:
        lasts = min(max(factor * duration, SHORTEST), LONGEST)
        begins = start + 0.5 * (duration - lasts)
        same = {name: size * duration / lasts for name, size in sizes.items()}
        found.append({**same, "event.start": begins, "event.duration": lasts})
    return found


EVENT = Cause(
    "event",
    "event",
    ("torque", "start", "duration"),
    "Something outside pushed the joint for a short time.",
    ADVICE,
    "time",
    lambda motion: np.zeros_like(motion.time),
    _starts,
    searched=True,
    valley=_stretched,
    shape=("start", "duration"),
    tolerance=of_impulse,
)

BODY_PUSH = Cause(
    "body_push",
    "event",
    ("x", "y", "z", *POINT, "start", "duration"),
    "Something outside pushed or pulled a body for a short time, which loads all joints between it and the base.",
    ADVICE,
    "time",
    lambda motion: np.zeros_like(motion.time),
    _starts,
    searched=True,
    valley=_stretched,
    shape=(*POINT, "start", "duration"),
    tolerance=of_force_impulse,
)

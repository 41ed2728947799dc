"""Body causes: masses, lengths and mounting of the robot."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint


def _starts(hint: Hint) -> list[dict[str, float]]:
    return [{"mass": share * hint.system.load_scale / 9.81} for share in (0.0, 0.1)]


PAYLOAD = Cause(
    "payload",
    "body",
    ("mass",),
    "A point mass is fixed to the robot.",
    "Weigh the tip, or hold it at rest at several angles and read the static command.",
    "theta",
    lambda motion: np.sin(motion.theta),
    _starts,
    also=("along",),
    also_summary="A point mass is fixed to a link; a wide interval of `along` says that it is the mass or its place.",
)
BODY_MASS = Cause(
    "body_mass",
    "body",
    ("factor",),
    "A body is heavier or lighter than the simulation assumes, in the same shape.",
    "Weigh the body, with all that is fixed to it.",
    "theta",
    lambda motion: np.sin(motion.theta),
    lambda hint: [{"factor": factor} for factor in (1.0, 0.7, 1.5)],
    regroups=True,
)
FORCE = Cause(
    "force",
    "body",
    ("x", "y", "z"),
    "A force of constant size and direction in the world pulls at a body: a cable, a hose, a counterweight, wind.",
    "Take cables and hoses off and keep moving air away, then record again; or turn the base and record again.",
    "theta",
    lambda motion: np.cos(motion.theta),
)
LENGTH = Cause(
    "length",
    "body",
    ("factor",),
    "A link is longer or shorter than the simulation assumes.",
    "Measure the link.",
    "theta",
    lambda motion: np.sin(motion.theta),
)
TILT = Cause(
    "tilt",
    "body",
    ("angle",),
    "The base is tilted, so that gravity pulls in another direction.",
    "Put a level on the base; or turn the base by a known angle and record again.",
    "theta",
    lambda motion: np.cos(motion.theta),
)

"""A drive that gives: a belt, a long shaft, a gear."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint

FREQUENCIES = tuple(
    1.0 * 1.5**k for k in range(10)
)  # that are tried [Hz]: a resonance is about as wide as its damping
SHARES = (0.1, 0.6)
DAMPING = 0.1  # of the starts: the answer of a weakly damped drive changes its sign within a few per cent of frequency


def _starts(hint: Hint) -> list[dict[str, float]]:
    del hint
    return [{"share": r, "frequency": f, "damping": DAMPING} for r in SHARES for f in FREQUENCIES]


ELASTIC = Cause(
    "elastic",
    "drive",
    ("share", "frequency", "damping"),
    "The drive of a joint gives: a belt, a shaft or a gear, and a part of the inertia swings behind it.",
    "Hold the motor and strike what it drives: it rings at the frequency given. Or stiffen the drive and record again.",
    "command",
    lambda motion: np.zeros_like(motion.time),
    _starts,
    choices=len(FREQUENCIES),
    shape=("frequency", "damping"),
)

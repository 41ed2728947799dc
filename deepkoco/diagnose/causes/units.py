"""Constants between units that are mixed up in practice."""

from __future__ import annotations

import math

from deepkoco.diagnose.causes.cause import Hint

# Radians and turns, radians and degrees, rad/s and rpm, milli, percent or hundredths, and a sign.
UNIT_CONSTANTS = (
    2.0 * math.pi,
    0.5 / math.pi,
    180.0 / math.pi,
    math.pi / 180.0,
    30.0 / math.pi,
    math.pi / 30.0,
    1000.0,
    1e-3,
    100.0,
    0.01,
    -1.0,
)
LARGE_MISFIT = 20.0  # chi2 per sample of the refitted baseline from which a slip of units is tried


def slip_starts(hint: Hint) -> list[dict[str, float]]:
    """Every constant, where the refitted baseline leaves far more than noise or has left its prior by far.

    A mass and an inertia that are free can take up a wrong unit of the command: then little is left of it in the
    residuals, and only the distance of the refit from its prior shows it.
    """
    return [{"factor": c} for c in UNIT_CONSTANTS] if hint.chi2 > LARGE_MISFIT or hint.strained else []

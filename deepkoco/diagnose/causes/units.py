"""Constants between units that are mixed up in practice."""

import math

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

"""Sine and cosine for compiled loops over rows of numbers, as arithmetic that becomes vector instructions.

The compiler calls the library for the sine of each number alone, which takes ten times as long.

Source: range reduction by pi/2 in three parts of 33 bits, and the minimax polynomials on [-pi/4, pi/4] of fdlibm,
e_rem_pio2.c, k_sin.c and k_cos.c (Sun Microsystems, 1993).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TURNS = 2.0 / math.pi
P1, P2, P3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21
FARTHEST = 1e5  # angle beyond which the three parts of pi/2 are too short [rad]
S1, S2, S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
S4, S5, S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
C1, C2, C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
C4, C5, C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


@njit(inline="always", error_model="numpy")
def near_sine_and_cosine(x):
    """Sine and cosine of an angle that is nearer than `FARTHEST` [rad]; anything else gives any number."""
    n = np.floor(x * TURNS + 0.5)
    r = ((x - n * P1) - n * P2) - n * P3
    z = r * r
    sine = r + r * z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6)))))
    cosine = 1.0 - 0.5 * z + z * z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6)))))
    # Quadrant 0 to 3, by arithmetic: conditions on integers would not be vector instructions.
    quadrant = n - 4.0 * np.floor(0.25 * n)
    half = np.floor(0.5 * quadrant)
    odd, sign = quadrant - 2.0 * half > 0.5, 1.0 - 2.0 * half
    return sign * (cosine if odd else sine), sign * (-sine if odd else cosine)


HALVINGS = 7
FADED = 40.0  # beyond it, what is left is less than the last bit of 1


@njit(inline="always", error_model="numpy")
def faded(x):
    """1 - exp(-x) of a number that is not negative, to some ten last bits.

    Source: the Taylor series of a small part of the number, then 1 - exp(-2 y) = f (2 - f) with f = 1 - exp(-y).
    """
    y = (x if x < FADED else FADED) / 128.0
    f = 1.0 - y / 12.0
    for n in range(11, 1, -1):
        f = 1.0 - y / n * f
    f *= y
    for _ in range(HALVINGS):
        f *= 2.0 - f
    return f

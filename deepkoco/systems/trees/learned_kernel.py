"""Terms of a learned load on the joints of a tree as a compiled loop."""

from __future__ import annotations

import math

from numba import njit

from deepkoco.systems.block_sizes import LANES
from deepkoco.systems.effects.learned import PLACES, REACH, SHARP, TERMS
from deepkoco.systems.uncounted import UNCOUNTED

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "c0da90697d7c5c20"

# Positions of the terms in `TERMS`.
(
    CONSTANT, V, V_ABS_V, V_CUBED, ABS_V, SIGN_V, U, U_ABS_U, U_CUBED, ABS_U, U_ABS_V, ABS_U_SIGN_V,
    BEYOND_0, BEYOND_1, BEYOND_2, ABOVE_P0, BELOW_P0, ABOVE_M0, BELOW_M0, ABOVE_P1, BELOW_P1, ABOVE_M1, BELOW_M1,
    ABOVE_P2, BELOW_P2, ABOVE_M2, BELOW_M2,
    SIN, COS, SIN_2, COS_2, V_SIN, V_COS, V_SIN_2, V_COS_2, SIGN_V_SIN, SIGN_V_COS, V_ABS_V_COS, U_SIN, U_COS,
) = range(len(TERMS))  # fmt: skip
SHARES = tuple(place / 100 for place in PLACES)


@njit(**UNCOUNTED)
def _within(value, reach):
    return min(max(value, -reach), reach)


@njit(**UNCOUNTED)
def _of_motion(term, v, sign, u):
    """Value of a term in speed and effort."""
    if term == CONSTANT:
        return 1.0
    if term == V:
        return v
    if term == V_ABS_V:
        return v * abs(v)
    if term == V_CUBED:
        return v * v * v
    if term == ABS_V:
        return abs(v)
    if term == SIGN_V:
        return sign
    if term == U:
        return u
    if term == U_ABS_U:
        return u * abs(u)
    if term == U_CUBED:
        return u * u * u
    if term == ABS_U:
        return abs(u)
    if term == U_ABS_V:
        return u * abs(v)
    return abs(u) * sign


@njit(**UNCOUNTED)
def _of_place(term, place):
    """Value of a spring that begins somewhere; ``place`` is the angle as a share of the range of the data."""
    if term <= BEYOND_2:
        share = SHARES[term - BEYOND_0]
        return place - _within(place, share)
    number = term - ABOVE_P0
    share = SHARES[number // 4]
    begin = share if number % 4 < 2 else -share
    return max(place - begin, 0.0) if number % 2 == 0 else min(place - begin, 0.0)


@njit(**UNCOUNTED)
def _of_angle(term, angle, v, sign, u):
    """Value of a term of a joint that turns."""
    if term == SIN:
        return math.sin(angle)
    if term == COS:
        return math.cos(angle)
    if term == SIN_2:
        return math.sin(2.0 * angle)
    if term == COS_2:
        return math.cos(2.0 * angle)
    if term == V_SIN:
        return v * math.sin(angle)
    if term == V_COS:
        return v * math.cos(angle)
    if term == V_SIN_2:
        return v * math.sin(2.0 * angle)
    if term == V_COS_2:
        return v * math.cos(2.0 * angle)
    if term == SIGN_V_SIN:
        return sign * math.sin(angle)
    if term == SIGN_V_COS:
        return sign * math.cos(angle)
    if term == V_ABS_V_COS:
        return v * abs(v) * math.cos(angle)
    if term == U_SIN:
        return u * math.sin(angle)
    return u * math.cos(angle)


@njit(**UNCOUNTED)
def add_term(term, values, angle, speed, effort, load):
    """Add one term to the load of a joint.

    Args:
        term: Position in `TERMS`.
        values: (5, LANES) weight; scales of speed, effort and angle; middle of the angles.
        angle, speed, effort: (LANES,) of the joint.
        load: (LANES,) is added to.
    """
    signed = term in (SIGN_V, ABS_U_SIGN_V, SIGN_V_SIN, SIGN_V_COS)
    for i in range(LANES):
        weight = values[0, i]
        if weight != 0.0:
            ratio = speed[i] / values[1, i]
            v, u = _within(ratio, REACH), _within(effort[i] / values[2, i], REACH)
            sign = math.tanh(ratio / SHARP) if signed else 0.0
            if term < BEYOND_0:
                load[i] += weight * _of_motion(term, v, sign, u)
            elif term < SIN:
                load[i] += weight * _of_place(term, _within((angle[i] - values[4, i]) / values[3, i], REACH))
            else:
                load[i] += weight * _of_angle(term, angle[i], v, sign, u)

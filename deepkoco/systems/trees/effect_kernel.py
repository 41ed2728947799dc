"""Forces of actuators and loads of effects on the joints of a tree as compiled loops."""

from __future__ import annotations

import math

from numba import njit

from deepkoco.systems.block_sizes import LANES, in_lanes, in_rows
from deepkoco.systems.sines import FARTHEST, near_sine_and_cosine
from deepkoco.systems.trees.learned_kernel import add_term
from deepkoco.systems.uncounted import UNCOUNTED

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "43de28462934bec5"

# Loads of effects that the loop knows; those from STRIBECK to before LEARNED are levels of dry friction. From LEARNED
# on, each is a term of a learned load.
VISCOUS, QUADRATIC, ASYMMETRIC_VISCOUS, SPRING, COGGING, PERIODIC, CROSSTALK, TORQUE_SPEED = range(8)
STRIBECK, LOAD_FRICTION, LEARNED = range(8, 11)
MOST_VALUES = 5  # of an effect


@njit(**UNCOUNTED)
def is_level(kind):
    """Whether an effect is a level of dry friction."""
    return STRIBECK <= kind < LEARNED


@njit(**UNCOUNTED)
def deliver(drives, gear, law, angle, speed, effort, forces):
    """Forces (M, LANES) of the actuators on their joints."""
    law, forces, angle, speed = in_rows(law, 8), in_lanes(forces), in_lanes(angle), in_lanes(speed)
    effort = in_lanes(effort)
    for a in range(len(drives)):
        k, ratio = drives[a], gear[a]
        for i in range(LANES):
            length, rate = ratio * angle[k, i], ratio * speed[k, i]
            scale = law[a, 0, i] + law[a, 1, i] * length + law[a, 2, i] * rate
            # A servo's stiff force is the difference of two large ones: the same as kp times the error.
            force = scale * effort[a, i] + (law[a, 3, i] + law[a, 4, i] * length + law[a, 5, i] * rate)
            force = law[a, 7, i] if force > law[a, 7, i] else force
            force = law[a, 6, i] if force < law[a, 6, i] else force
            forces[a, i] = ratio * force


@njit(**UNCOUNTED)
def add_levels(kinds, places, values, drives, forces, speed, level):
    """Add the levels of dry friction that depend on the motion to ``level`` (J, LANES)."""
    for e in range(len(kinds)):
        j = places[e, 0]
        if kinds[e] == STRIBECK:
            for i in range(LANES):
                if values[e, 0, i] != 0.0 or values[e, 1, i] != 0.0:
                    ratio = speed[j, i] / values[e, 2, i]
                    level[j, i] += values[e, 0, i] + values[e, 1, i] * math.exp(-ratio * ratio)
        elif kinds[e] == LOAD_FRICTION:
            for i in range(LANES):
                effort = 0.0
                for a in range(len(drives)):
                    effort += forces[a, i] if drives[a] == places[e, 1] else 0.0
                level[j, i] += values[e, 0, i] * abs(effort)


@njit(**UNCOUNTED)
def sum_of_forces(drives, joint, forces, effort):
    """Write what all actuators of a joint deliver to ``effort`` (LANES,)."""
    for i in range(LANES):
        effort[i] = 0.0
    for a in range(len(drives)):
        if drives[a] == joint:
            for i in range(LANES):
                effort[i] += forces[a, i]


@njit(**UNCOUNTED)
def add_loads(kinds, places, values, drives, forces, angle, speed, time, effort, load):
    """Add the loads of effects to ``load`` (J, LANES); ``effort`` (LANES,) is overwritten."""
    for e in range(len(kinds)):
        kind, j = kinds[e], places[e, 0]
        if kind == VISCOUS:
            for i in range(LANES):
                load[j, i] -= values[e, 0, i] * speed[j, i]
        elif kind == QUADRATIC:
            for i in range(LANES):
                load[j, i] -= values[e, 0, i] * speed[j, i] * abs(speed[j, i])
        elif kind == ASYMMETRIC_VISCOUS:
            for i in range(LANES):
                load[j, i] -= 0.5 * values[e, 0, i] * abs(speed[j, i])
        elif kind == SPRING:
            for i in range(LANES):
                load[j, i] -= values[e, 0, i] * (angle[j, i] - values[e, 1, i])
        elif kind in (COGGING, PERIODIC):
            far = False
            for i in range(LANES):
                acts = values[e, 0, i] != 0.0 or values[e, 1, i] != 0.0
                phase = values[e, 2, i] * (angle[j, i] if kind == COGGING else time[i])
                effort[i] = phase if acts else 0.0
                far |= not abs(effort[i]) < FARTHEST
            if not far:
                for i in range(LANES):
                    sine, cosine = near_sine_and_cosine(effort[i])
                    load[j, i] += values[e, 0, i] * sine + values[e, 1, i] * cosine
            else:
                for i in range(LANES):
                    sine, cosine = near_sine_and_cosine(effort[i])
                    if not abs(effort[i]) < FARTHEST:
                        sine, cosine = math.sin(effort[i]), math.cos(effort[i])
                    load[j, i] += values[e, 0, i] * sine + values[e, 1, i] * cosine
        elif kind == CROSSTALK:
            for a in range(len(drives)):
                if drives[a] == places[e, 1]:
                    for i in range(LANES):
                        load[j, i] += values[e, 0, i] * forces[a, i]
        elif kind == TORQUE_SPEED:
            sum_of_forces(drives, places[e, 1], forces, effort)
            for i in range(LANES):
                along = max(effort[i] * speed[j, i], 0.0)
                load[j, i] -= values[e, 0, i] * math.copysign(along, effort[i])
        elif kind >= LEARNED:
            sum_of_forces(drives, places[e, 1], forces, effort)
            add_term(kind - LEARNED, values[e], angle[j], speed[j], effort, load[j])

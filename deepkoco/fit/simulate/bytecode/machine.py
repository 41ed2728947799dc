"""The loop that runs bytecode: each instruction works on a row of numbers, one for each simulation of a block.

Torch needs some microseconds to begin an operation, and a step of a simulation has hundreds of them. Here a block of
simulations goes through all steps of its windows before the next block begins, and an instruction begins within
nanoseconds.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepkoco.systems.dry_friction import CLOSE, SWEEPS
from deepkoco.systems.dry_friction_loop import rub
from deepkoco.systems.sines import FARTHEST, near_sine_and_cosine
from deepkoco.systems.uncounted import UNCOUNTED

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "a3e761e9ec0ec8df"

OPCODES = (
    "add", "sub", "mul", "div", "neg", "abs", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh",
    "cosh", "tanh", "exp", "expm1", "log", "log1p", "pow", "sign", "floor", "ceil", "erf", "max", "min", "lt", "le",
    "gt", "ge", "eq", "ne", "and", "or", "xor", "not", "where", "copy",
)  # fmt: skip
"""Instructions by number: target, and up to three sources; truth is 1 and 0."""
BLOCK = 128  # simulations in a block: its rows stay in the cache


@njit(**UNCOUNTED, cache=True)
def execute(code: np.ndarray, table: np.ndarray, n: int) -> None:
    """Run instructions on the first n numbers of the rows of a table.

    Args:
        code: (K, 5) number of the instruction, row of its target, rows of its sources. No target is a source.
        table: (R, N) rows.
        n: How many numbers of a row count.
    """
    for k in range(code.shape[0]):
        op = code[k, 0]
        t, a, b, c = table[code[k, 1]], table[code[k, 2]], table[code[k, 3]], table[code[k, 4]]
        if op == 0:
            for i in range(n):
                t[i] = a[i] + b[i]
        elif op == 1:
            for i in range(n):
                t[i] = a[i] - b[i]
        elif op == 2:
            for i in range(n):
                t[i] = a[i] * b[i]
        elif op == 3:
            for i in range(n):
                t[i] = a[i] / b[i]
        elif op == 4:
            for i in range(n):
                t[i] = -a[i]
        elif op == 5:
            for i in range(n):
                t[i] = abs(a[i])
        elif op == 6:
            for i in range(n):
                t[i] = math.sqrt(a[i])
        elif op == 7:
            far = False
            for i in range(n):
                far |= not abs(a[i]) < FARTHEST
                t[i] = near_sine_and_cosine(a[i])[0]
            if far:
                for i in range(n):
                    if not abs(a[i]) < FARTHEST:
                        t[i] = math.sin(a[i])
        elif op == 8:
            far = False
            for i in range(n):
                far |= not abs(a[i]) < FARTHEST
                t[i] = near_sine_and_cosine(a[i])[1]
            if far:
                for i in range(n):
                    if not abs(a[i]) < FARTHEST:
                        t[i] = math.cos(a[i])
        elif op == 9:
            for i in range(n):
                t[i] = math.tan(a[i])
        elif op == 10:
            for i in range(n):
                t[i] = math.asin(a[i])
        elif op == 11:
            for i in range(n):
                t[i] = math.acos(a[i])
        elif op == 12:
            for i in range(n):
                t[i] = math.atan(a[i])
        elif op == 13:
            for i in range(n):
                t[i] = math.atan2(a[i], b[i])
        elif op == 14:
            for i in range(n):
                t[i] = math.sinh(a[i])
        elif op == 15:
            for i in range(n):
                t[i] = math.cosh(a[i])
        elif op == 16:
            for i in range(n):
                t[i] = math.tanh(a[i])
        elif op == 17:
            for i in range(n):
                t[i] = math.exp(a[i])
        elif op == 18:
            for i in range(n):
                t[i] = math.expm1(a[i])
        elif op == 19:
            for i in range(n):
                t[i] = math.log(a[i])
        elif op == 20:
            for i in range(n):
                t[i] = math.log1p(a[i])
        elif op == 21:
            for i in range(n):
                t[i] = a[i] ** b[i]
        elif op == 22:
            for i in range(n):
                t[i] = 1.0 if a[i] > 0.0 else (-1.0 if a[i] < 0.0 else 0.0 * a[i])
        elif op == 23:
            for i in range(n):
                t[i] = np.floor(a[i])
        elif op == 24:
            for i in range(n):
                t[i] = np.ceil(a[i])
        elif op == 25:
            for i in range(n):
                t[i] = math.erf(a[i])
        elif op == 26:  # not a number wins, as in torch
            for i in range(n):
                t[i] = a[i] if a[i] > b[i] or a[i] != a[i] else b[i]
        elif op == 27:
            for i in range(n):
                t[i] = a[i] if a[i] < b[i] or a[i] != a[i] else b[i]
        elif op == 28:
            for i in range(n):
                t[i] = 1.0 if a[i] < b[i] else 0.0
        elif op == 29:
            for i in range(n):
                t[i] = 1.0 if a[i] <= b[i] else 0.0
        elif op == 30:
            for i in range(n):
                t[i] = 1.0 if a[i] > b[i] else 0.0
        elif op == 31:
            for i in range(n):
                t[i] = 1.0 if a[i] >= b[i] else 0.0
        elif op == 32:
            for i in range(n):
                t[i] = 1.0 if a[i] == b[i] else 0.0
        elif op == 33:
            for i in range(n):
                t[i] = 1.0 if a[i] != b[i] else 0.0
        elif op == 34:
            for i in range(n):
                t[i] = 1.0 if a[i] != 0.0 and b[i] != 0.0 else 0.0
        elif op == 35:
            for i in range(n):
                t[i] = 1.0 if a[i] != 0.0 or b[i] != 0.0 else 0.0
        elif op == 36:
            for i in range(n):
                t[i] = 1.0 if (a[i] != 0.0) != (b[i] != 0.0) else 0.0
        elif op == 37:
            for i in range(n):
                t[i] = 1.0 if a[i] == 0.0 else 0.0
        elif op == 38:
            for i in range(n):
                t[i] = b[i] if a[i] != 0.0 else c[i]
        elif op == 39:
            for i in range(n):
                t[i] = a[i]


@njit(error_model="numpy", nogil=True, cache=True)
def bind(
    table, near, n, state_rows, rubbing, level_rows, inverse_rows, rows, creep_rows, creep_rates, impulsive,
    length_rows, h,
):  # fmt: skip
    """Find the friction loads of the simulations in which a joint turns, rests or leaves; as :func:`rubbed`.

    Args:
        table, n, state_rows, rubbing, level_rows, inverse_rows, creep_rows, creep_rates, impulsive, length_rows, h: As
            for :func:`roll`.
        near: (n,) whether friction loads are found.
        rows: As ``first_rub`` there.
    """
    r = rubbing.shape[0]
    joints = (rows.shape[0] - 3 * r) // 3
    picked = np.nonzero(near[:n] != 0.0)[0]
    count = picked.shape[0]
    before, after = np.empty((joints, count)), np.empty((joints, count))
    load, slide, stick = np.empty((r, count)), np.empty((r, count)), np.empty((r, count))
    inverse, creeps = np.empty((joints, joints, count)), np.zeros((r, 2, count))
    steps = np.full(count, h)
    for i in range(count):
        at = picked[i]
        for k in range(length_rows.shape[0]):
            steps[i] = table[length_rows[k], at]
        for j in range(joints):
            before[j, i] = table[state_rows[joints + j], at]
            after[j, i] = table[rows[j], at]
            for k in range(joints):
                inverse[j, k, i] = table[inverse_rows[j * joints + k], at]
        for k in range(r):
            load[k, i] = table[rows[joints + k], at]
            slide[k, i] = np.maximum(table[level_rows[k], at], 0.0)
            stick[k, i] = np.maximum(table[level_rows[r + k], at], 0.0)
        for k in range(creep_rows.shape[0]):
            creeps[k, 0, i], creeps[k, 1, i] = table[creep_rows[k], at], creep_rates[k]
    speed, moved, hold = np.empty((joints, count)), np.empty((joints, count)), np.empty((r, count))
    rub(
        before,
        after,
        load,
        slide,
        stick,
        inverse,
        rubbing,
        creeps,
        steps,
        impulsive,
        1 if r == 1 else SWEEPS,
        CLOSE,
        speed,
        moved,
        hold,
    )
    given = joints + r
    for i in range(count):
        at = picked[i]
        for j in range(joints):
            table[rows[given + j], at] = speed[j, i]
            table[rows[given + joints + j], at] = moved[j, i]
        for k in range(r):
            table[rows[given + 2 * joints + k], at] = load[k, i]
            table[rows[given + 2 * joints + r + k], at] = hold[k, i]


@njit(error_model="numpy", nogil=True, cache=True)
def roll(
    prologue, step, contact, again, mend, remember, table, constants, fixed, parameters, known, state, state_rows,
    begin, slope, length, pieces, effort_rows, clock, time_rows, length_rows, loads, load_rows, h, after_rows,
    near_row, rubbing, level_rows, inverse_rows, first_rub, second_rub, creep_rows, creep_rates, impulsive,
    mended_rows, memory_rows, value, first, last,
):  # fmt: skip
    """Simulate C windows over n steps, block by block.

    Args:
        prologue: Instructions that read parameters alone.
        step: Those of a step.
        contact, again, mend: Those of a step in which a joint with dry friction turns, rests or leaves: before its
            friction loads are found, between the two times that they are, and after.
        remember: Those for what effects remember.
        table: (R, N) rows; their content does not matter.
        constants: (c,) numbers, for the rows ``fixed``.
        parameters: (P, C), for the rows ``known``.
        state: (S, C) angles, speeds, shares at rest and memories at the start, for ``state_rows``.
        begin, slope: (n P, M, C) efforts at the start of each of the P pieces of each step, and their change per
            second.
        length: (n P, C) lengths of the pieces [s], 0 for a piece that there is not: the last ones of a
            step; (0, 0) where steps are in one.
        pieces: Number P.
        effort_rows: (3, M) rows of the efforts at start, middle and end of a step.
        clock: (C,) log time at the start [s].
        time_rows: (3,) rows of the time.
        length_rows: (1,) row of the length of the piece, or none where all steps have one.
        loads: (n, J, C) outside loads; (0, 0, 0) for none.
        load_rows: (J,)
        h: Step [s].
        after_rows: (4 J,) rows of angles, speeds and accelerations at both ends after ``step``.
        near_row: Row that tells where ``mend`` counts; -1 for none.
        rubbing: (r,) joints with dry friction.
        level_rows: (2 r,) rows of their levels: moving, and at rest.
        inverse_rows: (J J,) rows of the inverse inertia.
        first_rub, second_rub: Rows of what friction loads are found from, and into which they go: J speeds and r loads;
            J speeds, J ways, r loads and r holding loads. No rows of the second where they are found once.
        creep_rows: (r,) rows of the inertia with which friction creeps; none where it holds.
        creep_rates: (r,) rates at which it does.
        impulsive: Whether friction is an impulse of the whole step.
        mended_rows: (4 J + r,) as ``after_rows`` after ``mend``, with the shares at rest.
        memory_rows: Rows of the memories after ``remember``.
        value: (2 J, n + 1, C) angles and speeds, filled.
        first, last: (J, n, C) accelerations at both ends of each step, filled.
    """
    total, commands, columns = begin.shape
    width, joints = table.shape[1], first.shape[0]
    resting = mended_rows.shape[0] - 4 * joints if near_row >= 0 else 0
    long, since, live = np.full(width, h), np.zeros(width), np.ones(width, np.bool_)
    for r in range(fixed.shape[0]):
        table[fixed[r], :] = constants[r]
    for at in range(0, columns, width):
        n = min(width, columns - at)
        for r in range(known.shape[0]):
            table[known[r], :n] = parameters[r, at : at + n]
        for r in range(state_rows.shape[0]):
            table[state_rows[r], :n] = state[r, at : at + n]
        for s in range(2 * joints):
            value[s, 0, at : at + n] = state[s, at : at + n]
        execute(prologue, table, n)
        for p in range(total):
            k, later_piece = p // pieces, p % pieces != 0
            some = not later_piece
            for i in range(n):
                since[i] = since[i] if later_piece else 0.0
                if length.shape[0]:
                    live[i] = length[p, at + i] > 0.0
                    some = some or live[i]
                    # A piece that there is not is computed beside others, and left out.
                    long[i] = length[p, at + i] if live[i] else h
            if not some:
                continue
            for m in range(commands):
                for i in range(n):
                    e, de = begin[p, m, at + i], slope[p, m, at + i]
                    table[effort_rows[0, m], i] = e
                    table[effort_rows[1, m], i] = e + 0.5 * long[i] * de
                    table[effort_rows[2, m], i] = e + long[i] * de
            for i in range(n):
                now = clock[at + i] + (k * h + since[i])
                table[time_rows[0], i] = now
                table[time_rows[1], i] = now + 0.5 * long[i]
                table[time_rows[2], i] = now + long[i]
                since[i] += long[i]
            for j in range(length_rows.shape[0]):
                table[length_rows[j], :n] = long[:n]
            for j in range(load_rows.shape[0]):
                table[load_rows[j], :n] = loads[k, j, at : at + n]
            execute(step, table, n)
            some = False
            if near_row >= 0:
                near = table[near_row]
                for i in range(n):
                    near[i] = near[i] if live[i] else 0.0
                    some = some or near[i] != 0.0
                if some:
                    execute(contact, table, n)
                    bind(
                        table, near, n, state_rows, rubbing, level_rows, inverse_rows, first_rub, creep_rows,
                        creep_rates, impulsive, length_rows, h,
                    )  # fmt: skip
                    if second_rub.shape[0]:
                        execute(again, table, n)
                        bind(
                            table, near, n, state_rows, rubbing, level_rows, inverse_rows, second_rub, creep_rows,
                            creep_rates, impulsive, length_rows, h,
                        )  # fmt: skip
                    execute(mend, table, n)
                    for r in range(4 * joints):
                        own, other = table[after_rows[r]], table[mended_rows[r]]
                        for i in range(n):
                            own[i] = other[i] if near[i] != 0.0 else own[i]
            if memory_rows.shape[0]:
                execute(remember, table, n)
            for j in range(joints):
                a, b = table[after_rows[2 * joints + j]], table[after_rows[3 * joints + j]]
                for i in range(n):
                    if live[i]:  # a piece counts by its length
                        part = long[i] / h
                        first[j, k, at + i] = part * a[i] + (first[j, k, at + i] if later_piece else 0.0)
                        last[j, k, at + i] = part * b[i] + (last[j, k, at + i] if later_piece else 0.0)
            for s in range(2 * joints):
                own, other = table[state_rows[s]], table[after_rows[s]]
                for i in range(n):
                    own[i] = other[i] if live[i] else own[i]
                value[s, k + 1, at : at + n] = own[:n]
            for r in range(resting):
                own = table[state_rows[2 * joints + r]]
                share = table[mended_rows[4 * joints + r]]
                for i in range(n):
                    if live[i]:
                        own[i] = share[i] if some and near[i] != 0.0 else 0.0
            for r in range(memory_rows.shape[0]):
                own, other = table[state_rows[2 * joints + resting + r]], table[memory_rows[r]]
                for i in range(n):
                    own[i] = other[i] if live[i] else own[i]

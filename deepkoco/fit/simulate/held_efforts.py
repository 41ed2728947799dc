"""Exact time integrals of held efforts behind first-order lags, and the line over each step that has the same ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from deepkoco.fit.data.windows import CommandSeries

NOTHING = 1e-13  # length up to which a piece of a step is none [s]


class HeldEfforts:
    """Exact first and second time integrals of held efforts (U, n) behind first-order lags.

    On a grid, the error of a jump would depend on its position in its cell, and the cost would oscillate with the
    delay. On an unstable plant, these oscillations can be larger than the effect of a small delay.

    For a lag T y' + y = u, the integral of y is that of u minus T (y - y_0). Besides u, only the values y at the
    requested times are therefore needed.

    Args:
        command: Stamps of the log.
        effort: (U, n) efforts, each held from its stamp to the next.
        lags: (U,) time constants [s] of one or two lags in series; 0 for none. At the start of the log the lags are in
            steady state.
    """

    def __init__(self, command: CommandSeries, effort: np.ndarray, lags: Sequence[np.ndarray]) -> None:
        self.t, self.effort = np.array(command.t, dtype=float), np.array(effort, dtype=float)
        self.once, self.twice = np.empty_like(self.effort), np.empty_like(self.effort)
        _integrate(self.t, self.effort, self.once, self.twice)
        # Lags commute. With the shorter one first, the exponentials below do not overflow.
        chain = np.sort(np.array([*lags, *[np.zeros(len(effort))] * (2 - len(lags))]), axis=0)
        self.short, self.long = chain[-2], chain[-1]
        # Deviation of the output of each lag from the effort, at the stamps.
        shape = self.effort.shape if (self.long > 0.0).any() else (0, 0)
        self.first, self.second = np.zeros(shape), np.zeros(shape)
        gap = np.diff(self.t)
        lagged = np.flatnonzero(self.long > 0.0)
        for short, long in np.unique(np.column_stack([self.short, self.long])[lagged], axis=0):
            rows = np.flatnonzero((self.short == short) & (self.long == long))
            jump = -np.diff(self.effort[rows], axis=1)
            if short > 0.0:
                self.first[rows] = _lag_deviation(np.exp(-gap / short), jump)
                jump = jump + _long_lag_response(gap, short, long) * self.first[rows, :-1]
            self.second[rows] = _lag_deviation(np.exp(-gap / long), jump)

    def steps(
        self, row: np.ndarray, delay: np.ndarray, t0: np.ndarray, step: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Start values a and slopes b (n, W, R) of the efforts in rows (R,) or (R, W), each with a delay (R, W) [s].

        The line a + b s over each step has the same integral and double integral as the effort. The first command is
        assumed to hold at all times before the log.
        """
        a = np.empty((steps, len(t0), len(row)))
        b = np.empty_like(a)
        _lines(
            self.t, self.effort, self.once, self.twice, self.first, self.second, self.short, self.long,
            _of_each(row, len(t0)), np.array(delay, dtype=float), np.array(t0, dtype=float), step, a, b,
        )  # fmt: skip
        return a, b

    def between(
        self, row: np.ndarray, delay: np.ndarray, t0: np.ndarray, edges: np.ndarray, group: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As :meth:`steps`, over pieces of steps: (m, W, R).

        Args:
            row, delay, t0: As there.
            edges: (m + 1, W, G) starts and ends of the pieces after t0 [s].
            group: (R,) index among the G of each effort.
        """
        a = np.empty((len(edges) - 1, len(t0), len(row)))
        b = np.empty_like(a)
        _lines_between(
            self.t, self.effort, self.first, self.second, self.short, self.long, _of_each(row, len(t0)),
            np.array(delay, dtype=float), np.array(t0, dtype=float), np.ascontiguousarray(edges),
            np.array(group, np.int64), a, b,
        )  # fmt: skip
        return a, b


def _of_each(row: np.ndarray, windows: int) -> np.ndarray:
    """(R, W) rows, of (R,) or (R, W)."""
    return np.array(np.broadcast_to(row if row.ndim == 2 else row[:, None], (len(row), windows)), np.int64)


@njit(cache=True, error_model="numpy", nogil=True)
def _integrate(t, effort, once, twice):
    """Write the first and second time integrals of efforts (U, n) up to each stamp."""
    for u in range(effort.shape[0]):
        once[u, 0] = twice[u, 0] = 0.0
        for i in range(effort.shape[1] - 1):
            gap = t[i + 1] - t[i]
            twice[u, i + 1] = twice[u, i] + (once[u, i] * gap + 0.5 * effort[u, i] * (gap * gap))
            once[u, i + 1] = once[u, i] + effort[u, i] * gap


@njit(cache=True, error_model="numpy", nogil=True)
def _lag_deviation(keep, jump):
    """(U, n + 1) output minus input of a lag: x[0] = 0, x[i + 1] = keep[i] x[i] + jump[i]."""
    result = np.empty((jump.shape[0], jump.shape[1] + 1))
    for u in range(jump.shape[0]):
        result[u, 0] = 0.0
        for i in range(jump.shape[1]):
            result[u, i + 1] = keep[i] * result[u, i] + jump[u, i]
    return result


def _long_lag_response(since: np.ndarray, short: float, long: float) -> np.ndarray:
    """Response of the longer lag after a time to a unit deviation of the shorter lag from its input."""
    apart = since * (1.0 / short - 1.0 / long)  # never below 0
    # -expm1(-x) / x goes to 1 as x goes to 0, so equal lags need no special case.
    ratio = np.where(apart > 1e-12, -np.expm1(-apart) / np.where(apart > 1e-12, apart, 1.0), 1.0)
    return np.exp(-since / long) * since / long * ratio


@njit(cache=True, error_model="numpy", nogil=True)
def _lines(t, effort, once, twice, first, second, short, long, row, delay, t0, step, a, b):
    """Write the lines of :meth:`HeldEfforts.steps`: all nodes of a window in turn, so that stamps are passed once."""
    steps, last = a.shape[0], len(t) - 1
    cube = step**3
    for r in range(len(row)):
        for w in range(len(t0)):
            u = row[r, w]
            quick, slow, start = short[u], long[u], effort[u, 0]
            piece, before, twice_before = 0, 0.0, 0.0
            for k in range(steps + 1):
                at = (t0[w] + step * k) - delay[r, w]
                if k == 0:
                    piece = max(np.searchsorted(t, at, side="right") - 1, 0)
                while piece < last and t[piece + 1] <= at:
                    piece += 1
                inside, now = at - t[piece], effort[u, piece]
                so_far = once[u, piece] + now * inside
                twice_so_far = twice[u, piece] + inside * (once[u, piece] + 0.5 * now * inside)
                if slow > 0.0:
                    since, past = max(inside, 0.0), at - t[0]
                    two = second[u, piece] * math.exp(-since / slow)
                    if quick > 0.0:
                        one = first[u, piece] * math.exp(-since / quick)
                        apart = since * (1.0 / quick - 1.0 / slow)
                        ratio = -math.expm1(-apart) / apart if apart > 1e-12 else 1.0
                        two += first[u, piece] * (math.exp(-since / slow) * since / slow * ratio)
                        so_far -= quick * (now + one - start)
                        twice_so_far -= quick * (so_far - start * past)
                    so_far -= slow * (now + two - start)
                    twice_so_far -= slow * (so_far - start * past)
                if k > 0:
                    whole = so_far - before
                    double = (twice_so_far - twice_before) - step * before
                    slope = 12.0 * (0.5 * step * whole - double) / cube
                    b[k - 1, w, r] = slope
                    a[k - 1, w, r] = whole / step - 0.5 * step * slope
                before, twice_before = so_far, twice_so_far


@njit(cache=True, error_model="numpy", nogil=True)
def _outputs(now, first, second, quick, slow, since):
    """Outputs of the shorter lag and of both, some time after a stamp; the command is held at ``now``."""
    since = max(since, 0.0)
    one = two = 0.0
    if slow > 0.0:
        two = second * math.exp(-since / slow)
        if quick > 0.0:
            one = first * math.exp(-since / quick)
            apart = since * (1.0 / quick - 1.0 / slow)
            ratio = -math.expm1(-apart) / apart if apart > 1e-12 else 1.0
            two += first * (math.exp(-since / slow) * since / slow * ratio)
    return now + one, now + two


@njit(cache=True, error_model="numpy", nogil=True)
def _lines_between(t, effort, first, second, short, long, row, delay, t0, edges, group, a, b):
    """Write the lines of :meth:`HeldEfforts.between`.

    Integrals are summed from the start of each piece: a piece may be so short that the difference of two integrals
    from the start of the log would be rounding alone.
    """
    count, last = a.shape[0], len(t) - 1
    lagged = len(first) > 0
    for r in range(len(row)):
        g = group[r]
        for w in range(len(t0)):
            u = row[r, w]
            quick, slow = short[u], long[u]
            late = t0[w] - delay[r, w]
            piece = max(np.searchsorted(t, edges[0, w, g] + late, side="right") - 1, 0)
            for k in range(count):
                at, end = edges[k, w, g] + late, edges[k + 1, w, g] + late
                while piece < last and t[piece + 1] <= at:
                    piece += 1
                begin, whole, double, length = at, 0.0, 0.0, end - at
                while True:
                    stop = end if piece == last else min(t[piece + 1], end)
                    now, part = effort[u, piece], stop - begin
                    once, twice = now * part, 0.5 * now * part * part
                    if slow > 0.0 and lagged:
                        one, two = first[u, piece], second[u, piece]
                        q0, y0 = _outputs(now, one, two, quick, slow, begin - t[piece])
                        q1, y1 = _outputs(now, one, two, quick, slow, stop - t[piece])
                        # For T y' + y = u, the integral of y is that of u minus T (y - y_0).
                        if quick > 0.0:
                            once -= quick * (q1 - q0)
                            twice -= quick * (once - q0 * part)
                        once -= slow * (y1 - y0)
                        twice -= slow * (once - y0 * part)
                    double += whole * part + twice
                    whole += once
                    if piece == last or stop >= end:
                        break
                    begin = stop
                    piece += 1
                if length > NOTHING:
                    slope = 12.0 * (0.5 * length * whole - double) / length**3
                    b[k, w, r], a[k, w, r] = slope, whole / length - 0.5 * length * slope
                else:
                    b[k, w, r], a[k, w, r] = 0.0, effort[u, piece]

"""Time stamps of a loop that scatter: the even times behind them, where the motion shows these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.fft import dst
from scipy.linalg import solveh_banded
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar

from deepkoco.fit.data.late_stamps import without_waiting
from deepkoco.fit.data.noise import difference_weights

FEWEST = 100  # samples from which the scatter of stamps is estimated
MOST = (
    0.12  # of the period: where stamps scatter by more, it is not sure to which turn of the loop each belongs
)
NEAR = 25  # samples, of which the typical delay tells the turn of the loop that each belongs to
WANDER = np.geomspace(1e-6, 1e6, 61)  # variance of the loop's own steps over that of the stamps, as searched
ALIKE = 2.0  # ratio of the scatters of commands and samples up to which one clock stamped both
COMMON, COMMON_SDS = 0.9, 1.645  # share of the gaps that are no pause; standard deviations that it reaches to
ROUNDINGS = 16.0  # of the largest stamp, within which gaps are equal: stamps are converted and subtracted
FAR = 5.0  # standard deviations of a gap from which it is a pause of the loop
EVIDENCE = 16.0  # fall of minus twice the log likelihood from which the even times are believed
ORDERS = range(2, 7)  # of the differences of samples; the one with the least motion in it is used
CLIP = 4.0  # standard deviations of a difference beyond which it does not count

Series = tuple[np.ndarray, np.ndarray]


def with_even_stamps(
    series: Mapping[str, Series], commands: Sequence[np.ndarray]
) -> tuple[dict[str, Series], list[np.ndarray]]:
    """Return measurements and command stamps of one log, moved to the even times that the motion shows.

    Rows that waited to be stamped and came together are first moved to their turns, see :mod:`.late_stamps`. A
    computer that stamps a regular loop late or early stamps commands and samples alike. A sample is then only as
    wrong as the motion is fast. A command acts at another time than the simulation takes it, and every jump of it is an
    impulse that stays in the speed. Both errors vanish at the even times. A loop may also be irregular itself, and its
    stamps right. The measured motion decides: it is smoother against the times at which it was measured.

    Args:
        series: Channel -> (n,) stamps [s], increasing, and (n,) values.
        commands: Stamps of each command [s], increasing.

    Returns:
        The series and the commands with their stamps. Commands are moved with samples that have the same stamps, or
        stamps that scatter as much: one clock took both. Stamps that do not scatter, or of which the motion does not
        show it, are returned as they are.
    """
    result, moved = dict(series), list(commands)
    for t in _clocks(series):
        own = {name: value for name, (stamps, value) in series.items() if np.array_equal(stamps, t)}
        values = list(own.values())
        taken = without_waiting(t, values)
        if taken is not t:
            moved = [_with_the_row(command, t, taken) for command in moved]
            result |= {name: (taken, value) for name, value in own.items()}
        even = even_times(taken)
        share = 0.0 if even is None else share_of_scatter(taken, even, values)
        if even is None or share == 0.0:
            continue
        times = _towards(taken, even, share)
        result |= {name: (times, value) for name, value in own.items()}
        moved = [_moved_alike(command, taken, even, share) for command in moved]
    return result, moved


def _with_the_row(command: np.ndarray, t: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return ``times`` of commands that are in the rows of samples with stamps ``t``; others as they are."""
    at = np.searchsorted(t, command)
    return times[at] if (at < len(t)).all() and np.array_equal(t[at], command) else command


def _moved_alike(command: np.ndarray, t: np.ndarray, even: np.ndarray, share: float) -> np.ndarray:
    """Return stamps of commands that were taken by the clock of samples with stamps ``t``; others as they are."""
    with_row = _with_the_row(command, t, _towards(t, even, share))
    if with_row is not command:
        return with_row
    own = even_times(command)
    if own is None or not 1.0 / ALIKE <= np.std(own - command) / np.std(even - t) <= ALIKE:
        return command
    return _towards(command, own, share)


def _towards(t: np.ndarray, even: np.ndarray, share: float) -> np.ndarray:
    # No two rows get one time.
    apart = 0.5 * float(np.diff(t).min()) * np.arange(len(t))
    return np.maximum.accumulate(t + share * (even - t) - apart) + apart


def even_times(t: np.ndarray) -> np.ndarray | None:
    """Return the times of a loop whose stamps scatter: its period may wander, and each stamp is late or early alone.

    The model is x_{k+1} = x_k + m_k T + w_k and t_k = x_k + e_k, with w and e independent and normal. The gaps tell
    the most likely variances of w and e. The most likely x then solves a tridiagonal system.

    Args:
        t: (n,) stamps [s], increasing.

    Returns:
        (n,) times [s]; None where stamps are few or regular, or scatter too much to count periods.
    """
    if len(t) < FEWEST:
        return None
    gap = np.diff(t)
    period = float(np.median(gap))
    if not period > 0.0:
        return None
    turn = np.append(0.0, np.cumsum(np.round(gap / period)))
    period = float(np.polyfit(turn, t - t[0], 1)[0])
    # A late stamp may be nearer to the next turn of the loop than to its own; its neighbours show it.
    phase = t - t[0] - period * turn
    turn += np.round((phase - median_filter(phase, NEAR, mode="nearest")) / period)
    count = np.diff(turn)
    off = gap - count * period
    middle = float(np.median(off))
    away, least = np.abs(off - middle), ROUNDINGS * float(np.spacing(np.abs(t).max()))
    spread = 1.4826 * float(np.median(away))
    # Of stamps in whole milliseconds, more than half of the gaps may be the usual one, and the others tell how far.
    spread = spread if spread > least else float(np.quantile(away, COMMON)) / COMMON_SDS
    # Below the rounding of the numbers themselves the stamps of most gaps do not scatter.
    if not least < spread <= MOST * np.sqrt(2.0) * period:
        return None
    # A few gaps that are a little longer tilt the fitted period by more than regular stamps scatter.
    usual = np.abs(off - middle) <= FAR * spread
    if float(np.ptp(off[usual])) <= least:
        return None
    period += float(off[usual].sum() / count[usual].sum())
    off = np.where(usual, gap - count * period, 0.0)
    n = len(off)
    scatter, stiff = _scatter_and_stiffness(off, count, usual)
    if not scatter > 1e-4 * float(off[usual].var()):
        return None
    link = np.where(usual, stiff, 0.0)  # a pause tells nothing of the time after it
    diagonal = np.ones(n + 1)
    diagonal[:-1] += link
    diagonal[1:] += link
    band = np.zeros((2, n + 1))
    band[0, 1:], band[1] = -link, diagonal
    # The times are linear in the period, which is fitted with them.
    right = np.zeros((n + 1, 2))
    right[:, 0] = t - t[0]
    for k, pull in enumerate((link * count * period, link * count)):
        right[:-1, k] -= pull
        right[1:, k] += pull
    even, longer = solveh_banded(band, right).T
    left = [t - t[0] - even, np.sqrt(link) * (np.diff(even) - count * period)]
    moved = [-longer, np.sqrt(link) * (np.diff(longer) - count)]
    more = -sum(a @ b for a, b in zip(left, moved, strict=True)) / sum(b @ b for b in moved)
    return t[0] + even + more * longer


def _scatter_and_stiffness(off: np.ndarray, count: np.ndarray, usual: np.ndarray) -> tuple[float, float]:
    """Return the most likely variance r of stamps [s^2], and r over the variance q of the loop's own steps.

    The gaps have the tridiagonal covariance q I + r L, L with 2 beside -1. The sine transform diagonalises it, with
    eigenvalues q + r (2 - 2 cos(pi k / (m + 1))) for m gaps in one run (harmonics of a fixed string). The
    error of the period is fitted with the variances.

    Args:
        off: (n,) gaps less their whole turns [s].
        count: (n,) turns of each gap.
        usual: (n,) true where a gap is no pause; pauses part the runs.
    """
    ends = np.flatnonzero(np.diff(np.concatenate([[False], usual, [False]])))
    runs = [slice(*run) for run in ends.reshape(-1, 2)]
    late, turns = (
        np.concatenate([np.asarray(dst(signal[run], type=1, norm="ortho")) for run in runs])
        for signal in (off, count)
    )
    bare = np.concatenate(
        [2.0 - 2.0 * np.cos(np.pi * np.arange(1, m + 1) / (m + 1)) for m in np.ptp(ends.reshape(-1, 2), 1)]
    )

    def variance(size: np.ndarray) -> float:
        longer = (late * turns / size).sum() / (turns**2 / size).sum()
        return float(np.mean((late - longer * turns) ** 2 / size))

    def misfit(log_ratio: float) -> float:
        size = np.exp(log_ratio) + bare
        return len(bare) * float(np.log(variance(size))) + float(np.log(size).sum())

    grid = np.log(WANDER)
    best = int(np.argmin([misfit(at) for at in grid]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found: Any = minimize_scalar(misfit, bounds=bounds, method="bounded")
    ratio = float(np.exp(found.x))
    return variance(ratio + bare), 1.0 / ratio


def share_of_scatter(t: np.ndarray, even: np.ndarray, values: list[np.ndarray]) -> float:
    """Return the share of the distance from stamps to even times that measurements show, 0 to 1.

    A sample that was taken at the even time differs from the smooth motion at its stamp by the rate times the
    distance. Divided differences of the samples remove the motion and keep this. Their regression on the differences
    of rate times distance gives the share.

    Args:
        t: (n,) stamps [s].
        even: (n,) even times [s].
        values: (n,) measurements at these stamps, one for each channel.

    Returns:
        The share; 0 without evidence, 1 where the measurements do not contradict the even times.
    """
    top, weight = 0.0, 0.0
    for value in values:
        rate = np.zeros(len(t))
        rate[2:-2] = (value[4:] - value[:-4]) / np.maximum(t[4:] - t[:-4], 1e-12)
        best = None
        for order in ORDERS:
            weights, rows = difference_weights(t, order)
            shown = (weights * value[rows]).sum(1)
            wanted = (weights * (rate * (even - t))[rows]).sum(1)
            inside = np.ones(len(shown), dtype=bool)
            share, sd = 0.0, np.inf
            for _ in range(4):
                power = float((wanted[inside] ** 2).sum())
                share = float((wanted * shown)[inside].sum()) / power if power > 0.0 else 0.0
                rest = shown - share * wanted
                sd = float(np.sqrt(np.mean(rest[inside] ** 2)))
                inside = np.abs(rest) <= CLIP * sd
            # Neighbouring differences share samples: about one in order + 1 is independent.
            told = power / max(sd**2, 1e-300) / (order + 1)
            if best is None or told > best[1]:
                best = share, told
        if best is not None and best[1] > 0.0:
            top, weight = top + best[0] * best[1], weight + best[1]
    if weight == 0.0:
        return 0.0
    share, error = top / weight, 1.0 / np.sqrt(weight)
    if share <= 0.0 or (share / error) ** 2 < EVIDENCE:
        return 0.0
    return 1.0 if share + 2.0 * error >= 1.0 else share


def _clocks(series: Mapping[str, Series]) -> list[np.ndarray]:
    """Return the different stamps of some channels."""
    found: list[np.ndarray] = []
    for t, _ in series.values():
        if not any(np.array_equal(t, other) for other in found):
            found.append(t)
    return found

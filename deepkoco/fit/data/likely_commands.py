"""The most likely commands of a log whose rows hold noise that no motor felt.

The rough part of a logged command tells of such noise: a command that acted is smooth next to white noise of a sensor.
With the spectrum S of the log, and the spectrum c by which noise and log go together, the most likely noise is the log
behind the filter c / S of no phase: most of what is rough, and next to nothing where the command has power. The noise
that stays is independent of the commands that are left, so no fit gains by damping them. With noise still in the
commands, a weaker drive or a lag would seem to explain a log. Sources: Wiener, Extrapolation, Interpolation, and
Smoothing of Stationary Time Series (1949); Carroll et al., Measurement Error in Nonlinear Models (2006), on regression
calibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import oaconvolve, welch

from deepkoco.fit.data.series import CommandSeries

SEGMENT, SHORTEST = 256, 32  # commands whose spectrum is taken
SEGMENTS = 4  # of them at least that show a spectrum
HELD = 4.0  # times the usual rows of a command, from which it is exact: a rest, or a limit


class _Piece(NamedTuple):
    """Commands that change all the time.

    Attributes:
        value: Each of them once.
        rows: (n + 1,) row from which each of them is held, and the row behind the last one.
    """

    value: np.ndarray
    rows: np.ndarray


def likely_commands(commands: Sequence[CommandSeries], logged: Sequence[float]) -> tuple[CommandSeries, ...]:
    """Return the most likely commands of logs of one recorder.

    Args:
        commands: As logged, (n,) or (n, M) each.
        logged: (M,) square root of the covariance of noise that no motor felt with the logged command, as independent
            noise of each row, in the command's unit; 0 where the log does not hold the noise.

    Returns:
        The same logs with other values; as logged where a command rests, stops at a limit or changes too seldom.
    """
    values = [np.array(command.value, dtype=float) for command in commands]
    for index, told in enumerate(logged):
        columns = [value if value.ndim == 1 else value[:, index] for value in values]
        held = max(float(np.median(np.concatenate([_lengths(own) for own in columns]))), 1.0)
        pieces = [_pieces(own, HELD * held) for own in columns]
        listed = [piece.value for own in pieces for piece in own]
        segment = _segment(listed)
        if told == 0.0 or segment == 0:
            continue
        # Rows that repeat a command repeat its noise.
        response = _response(listed, told**2 / held, segment)
        for own, some in zip(columns, pieces, strict=True):
            for piece in some:
                left = piece.value - _filtered(piece.value, response)
                own[piece.rows[0] : piece.rows[-1]] = np.repeat(left, np.diff(piece.rows))
    return tuple(replace(own, value=value) for own, value in zip(commands, values, strict=True))


def _lengths(column: np.ndarray) -> np.ndarray:
    """Return how many rows hold each command in turn."""
    return np.diff(np.concatenate([[0], np.flatnonzero(np.diff(column) != 0.0) + 1, [len(column)]]))


def _pieces(column: np.ndarray, longest: float) -> list[_Piece]:
    """Return the commands between those that are held for more rows than ``longest``."""
    rows = np.concatenate([[0], np.cumsum(_lengths(column))])
    exact = np.flatnonzero(np.diff(rows) > longest)
    edges = np.concatenate([[-1], exact, [len(rows) - 1]])
    found = [(int(a) + 1, int(b)) for a, b in pairwise(edges)]
    return [_Piece(column[rows[a:b]], rows[a : b + 1]) for a, b in found if b - a >= SHORTEST // 2]


def _segment(pieces: Sequence[np.ndarray]) -> int:
    """Return the even number of commands whose spectrum these pieces show; 0 where they show none."""
    total, longest = sum(map(len, pieces)), max(map(len, pieces), default=0)
    segment = min(total // SEGMENTS, longest, SEGMENT) // 2 * 2
    return segment if segment >= SHORTEST else 0


def _response(pieces: Sequence[np.ndarray], covariance: float, segment: int) -> np.ndarray:
    """Return the later half of the impulse response of no phase that leaves the most likely noise of a command."""
    long = [own for own in pieces if len(own) >= segment]
    spectra = np.array([welch(own, nperseg=segment, detrend="linear")[1] for own in long])
    power = np.average(spectra, axis=0, weights=[len(own) for own in long])
    power[-1] *= 2.0  # a spectrum of one side has the highest frequency once
    share = 2.0 * covariance / np.maximum(power, 2.0 * covariance)
    share[:2] = 0.0  # the segments have no mean and no slope
    response = np.fft.irfft(share)[: len(share)]
    response[-1] *= 0.5  # it is of both sides
    return response


def _filtered(value: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return values behind a filter; they go on beyond their ends as they came, turned by half a circle."""
    beyond = np.pad(value, len(response) - 1, mode="reflect", reflect_type="odd")
    both = np.concatenate([response[:0:-1], response])
    return oaconvolve(beyond, both, mode="valid")

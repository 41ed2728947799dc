"""Positions of joints of which a log shows the speed alone: the integral of the speed, along the whole log.

A gyro or a tachometer leaves the position of each window open. Where loads depend on it (a weight, a detent), a window
has several positions at which its cost has a minimum, and a guess of 0 lets neighbouring windows end in different ones.
Parameters are then fitted to motions that no unit made. The integral ties the windows together; its drift is small
beside a turn. It counts from 0 at the first sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

Series = Mapping[str, tuple[np.ndarray, np.ndarray]]


def unseen_positions(
    logs: Sequence[Series],
    names: Sequence[str],
    shows: Sequence[int],
    joints: int,
    log: np.ndarray,
    t0: np.ndarray,
) -> np.ndarray:
    """Return the positions at the starts of windows (W, J); 0 where the position is shown, or not even the speed.

    Args:
        logs: Stamps and values of the channels of each log.
        names: Names of the channels.
        shows: Index of the state that each channel measures.
        joints: Number of joints J.
        log: (W,) index of the window's log.
        t0: (W,) start in its log's time [s].
    """
    result = np.zeros((len(t0), joints))
    for index, series in enumerate(logs):
        channel = {s: series[n] for n, s in zip(names, shows, strict=True) if n in series}
        own = log == index
        for j in range(joints):
            if j in channel or j + joints not in channel:
                continue
            t, speed = channel[j + joints]
            way = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t)))
            result[own, j] = np.interp(t0[own], t, way)
    return result


def carried_on(
    state: np.ndarray, t: np.ndarray, value: np.ndarray, valid: np.ndarray, shows: Sequence[int], until: float
) -> dict[int, float]:
    """Return the positions of joints after a part of a window in which only their speeds are shown, by joint.

    Args:
        state: (S,) guess of the state at the start of the window.
        t, value, valid: (N, M) stamps after its start [s], measurements, and where there is one.
        shows: Index of the state that each channel measures.
        until: Length of the part [s].
    """
    joints = len(state) // 2
    seen = {s: c for c, s in enumerate(shows) if valid[c].any()}
    result = {}
    for j in range(joints):
        if j in seen or j + joints not in seen:
            continue
        c = seen[j + joints]
        speed = value[c, valid[c] & (t[c] < until)]
        result[j] = float(state[j] + (until * speed.mean() if len(speed) else 0.0))
    return result

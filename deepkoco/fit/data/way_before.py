"""The way of a joint before a window: its last turning points, which decide how its bristles are bent.

What an effect remembers of a way (:class:`deepkoco.systems.joint_state.Memory`) cannot be read from the state at the
start of a window, but from the log before it. While a joint moves in one direction only the way counts, so turning
points are all there is to know.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.turning_points import write_turning_points
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

POINTS = 8  # last turning points that are kept: each way between two of them forgets those before
ABOVE_NOISE = (
    6.0  # noise standard deviations that a joint must go back by; a flicker of one tick is 3.5 of them
)


def hidden_by(noise: Sequence[Noise], system: System) -> tuple[float, ...]:
    """Per joint, the way up to which the noise of its encoder hides a motion; 0 for one that is not measured."""
    sd = {s: noise[c].sd for c, s in enumerate(system.measured_states)}
    return tuple(ABOVE_NOISE * sd.get(j, 0.0) for j in range(system.joints))


def ways_of(
    recordings: Sequence[Recording],
    series: Sequence[Mapping[str, tuple[np.ndarray, np.ndarray]]],
    log: np.ndarray,
    starts: np.ndarray,
    system: System,
    unseen: Sequence[float],
) -> np.ndarray:
    """Return the ways before windows of several logs, as :func:`ways_before` does for one.

    Args:
        recordings: The logs.
        series: Of each log: channel -> stamps and values.
        log: (W,) log of each window.
        starts: (W,) their starts in the log's time [s], rising in each log.
        system: Says which channel shows which joint.
        unseen: Per joint, the way up to which noise hides a motion.
    """
    result = np.zeros((len(log), system.joints, POINTS + 1))
    shown = {
        s: system.measurements[c].name for c, s in enumerate(system.measured_states) if s < system.joints
    }
    for index, (recording, own) in enumerate(zip(recordings, series, strict=True)):
        positions = {joint: own[name] for joint, name in shown.items() if name in own}
        mine = log == index
        result[mine] = ways_before(positions, unseen, starts[mine], system.joints, recording.unknown)
    return result


def ways_before(
    series: Mapping[int, tuple[np.ndarray, np.ndarray]],
    unseen: Sequence[float],
    starts: np.ndarray,
    joints: int,
    gaps: Sequence[tuple[float, float]] = (),
) -> np.ndarray:
    """Return the positions of each joint at its last turning points before each start, and at the start.

    Args:
        series: Joint -> stamps (n,) [s] and positions (n,).
        unseen: Per joint, the way up to which noise hides a motion.
        starts: (W,) times [s], rising.
        joints: How many joints.
        gaps: Begin and end of stretches of which nothing is known [s]; the way begins after them.

    Returns:
        (W, J, `POINTS` + 1), in the order of time. Where less is known, the first known position is repeated; a joint
        that is not measured stays at 0.
    """
    result = np.zeros((len(starts), joints, POINTS + 1))
    ends = np.sort(np.array([end for _, end in gaps]))
    for joint, (stamps, positions) in series.items():
        known = np.isfinite(positions)
        t, q = stamps[known], _without_glitches(positions[known])
        if len(t):
            at = np.searchsorted(t, starts, side="right")
            since = np.zeros(len(starts), dtype=np.int64)
            if len(ends):
                last = np.searchsorted(ends, starts, side="right") - 1
                since = np.where(last >= 0, np.searchsorted(t, ends[last]), 0)
            write_turning_points(q, at, since, unseen[joint], result[:, joint])
    return result


def way_after(way: np.ndarray, unseen: Sequence[float], positions: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return the way (J, `POINTS` + 1) before a time, from the one before an earlier time and the positions between.

    Args:
        way: (J, `POINTS` + 1), as :func:`ways_before` returns it.
        unseen: Per joint, the way up to which noise hides a motion.
        positions: Joint -> positions (n,) since then.
    """
    result = way.copy()
    for joint, since in positions.items():
        if len(since):
            q = np.concatenate([way[joint], _without_glitches(since)])
            begin, end = np.zeros(1, dtype=np.int64), np.array([len(q)])
            write_turning_points(q, end, begin, unseen[joint], result[joint][None])
    return result


def _without_glitches(q: np.ndarray) -> np.ndarray:
    """Positions in which no single sample stands out: a median of three. A wrong reading is no way there and back."""
    inner = np.median(np.stack([q[:-2], q[1:-1], q[2:]]), axis=0) if len(q) > 2 else q[1:-1]
    return np.concatenate([q[:1], inner, q[-1:]]) if len(q) > 1 else q

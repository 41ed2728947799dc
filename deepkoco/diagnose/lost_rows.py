"""Whether gaps between regular rows are rows that a log lost, or turns that a loop skipped.

A command acted in a row that is lost, and another one holds on in the log. In a turn that the loop skipped, the command
before held on. The log decides: gaps are lost rows where a refit with commands between those of their neighbours leaves
less than one with commands that hold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.as_engine import SOME
from deepkoco.diagnose.left_of_logs import LeftOfLogs
from deepkoco.fit.data.windows import cut_windows, estimate_channels, moving
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.lost_rows import with_lost_rows
from deepkoco.logs.recording import Recording
from deepkoco.systems import System


def with_lost_rows_if_shown(
    groups: Sequence[Sequence[Recording]], system: System, length: float
) -> list[Sequence[Recording]]:
    """Return groups of logs of one recorder, with commands in the rows that they lost.

    Args:
        groups: Logs to explain, and others, of the same unit.
        system: The system.
        length: Of the windows that decide [s].
    """
    filled = [[with_lost_rows(recording) for recording in group] for group in groups]
    held, other = [], []
    for group, new in zip(groups, filled, strict=True):
        changed = [(a, b) for a, b in zip(group, new, strict=True) if a is not b]
        held += [a for a, _ in changed]
        other += [b for _, b in changed]
    if not held:
        return list(groups)
    try:
        left = [_left(logs, system, length) for logs in (held, other)]
    except DivergedError:
        return list(groups)
    return list(filled) if left[1] < left[0] else list(groups)


def _left(recordings: Sequence[Recording], system: System, length: float) -> float:
    """What the simulation of a machine leaves of some windows of logs, in variances of the noise.

    Raises:
        DivergedError: The simulation diverges.
    """
    windows = cut_windows(recordings, system, length, estimate_channels(recordings, system))
    windows = windows.take(moving(windows)) if len(windows) else windows
    if len(windows) == 0:
        return 0.0
    windows = windows.take(np.unique(np.linspace(0, len(windows) - 1, SOME).astype(int)))
    return LeftOfLogs(windows)(system).cost

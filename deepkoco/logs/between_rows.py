"""Commands of a controller that is faster than its log: a row shows one of several that act until the next.

A row shows the command at its instant. A controller of 1 kHz that is logged at 200 Hz has changed it four times before
the next row. Held until then, it would act up to half a row late, which a good encoder shows a hundred times over. So
each row stands for the commands around it: the faster the controller, the nearer to half a row before. What the command
did beside it is noise that no log shows (:mod:`deepkoco.fit.solve.command_noise`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.logs.recording import Recording

OFTEN = 0.5  # share of the rows of a motion that change a command, from which its controller may be faster
EARLIEST = 0.5  # rows by which the commands of a faster controller act before their row at most


def earlier(t: np.ndarray, rows: float) -> np.ndarray:
    """Return stamps (n,) that are earlier by a number of typical rows."""
    return t - rows * float(np.median(np.diff(t)))


def changes_often(value: np.ndarray) -> bool:
    """Whether commands (n,) or (n, M) change at most rows of a motion: its controller is no slower than its log."""
    changed = (np.diff(value.reshape(len(value), -1), axis=0) != 0.0).any(1)
    if not changed.any():
        return False
    first, last = np.flatnonzero(changed)[[0, -1]]
    return float(changed[first : last + 1].mean()) >= OFTEN


def with_commands_around_rows(recording: Recording, rows: float) -> Recording:
    """Return a log whose commands act from a share of a row before they are logged, with a warning; itself for 0."""
    if rows == 0.0:
        return recording
    names = recording.names("command")
    series = {name: recording.channels[name] for name in names if len(recording.channels[name]) > 2}
    early = {name: replace(s, t=earlier(s.t, rows)) for name, s in series.items()}
    told = ", ".join(f'"{n}"' for n in names)
    return replace(
        recording,
        channels={**recording.channels, **early},
        warnings=(
            *recording.warnings,
            f"{told} {'changes' if len(names) == 1 else 'change'} between rows, too, by a controller that is faster "
            f"than the log: each row stands for what acts from {rows:.2g} of a row before it on",
        ),
    )

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


def changes_often(value: np.ndarray) -> bool:
    """Whether commands (n,) or (n, M) change at most rows of a motion: their controller is no slower than these."""
    changed = (np.diff(value.reshape(len(value), -1), axis=0) != 0.0).any(1)
    if not changed.any():
        return False
    first, last = np.flatnonzero(changed)[[0, -1]]
    return float(changed[first : last + 1].mean()) >= OFTEN


def with_early_commands(recording: Recording, lead: float) -> Recording:
    """Return a log whose commands act some time [s] before they are logged, with a warning; itself for 0."""
    names = recording.names("command")
    if lead == 0.0 or not names:
        return recording
    told = ", ".join(f'"{n}"' for n in names)
    return replace(
        recording,
        early=lead,
        unknown=tuple((begin - lead, end) for begin, end in recording.unknown),
        warnings=(
            *recording.warnings,
            f"{told} {'acts' if len(names) == 1 else 'act'} {1e3 * lead:.3g} ms before the rows that show "
            f"{'it' if len(names) == 1 else 'them'}: the controller is faster than the log, and a row stands for "
            "what acts around it (or the stamps of the commands are late by as much, or a simulation in steps of "
            f"{2e3 * lead:.3g} ms made the log)",
        ),
    )

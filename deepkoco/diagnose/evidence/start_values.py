"""Data from which the causes of the catalogue choose their start values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.causes import Cause, Hint
from deepkoco.diagnose.causes.driving import driving_command
from deepkoco.diagnose.evidence.pushed_bodies import WIDTHS, pushes_of_bodies
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.simulate.push import AXES
from deepkoco.systems import System


class Hints:
    """Data for the start values of every cause, from the training windows.

    Args:
        system: The system.
        windows: Training windows.
        missing: Missing load of the refitted baseline on each joint.
        chi2: chi2 per sample of the refitted baseline.
        strained: Whether the refit is far from its prior.
    """

    def __init__(
        self,
        system: System,
        windows: Windows,
        missing: Sequence[MissingTorque],
        chi2: float,
        strained: bool = False,
    ) -> None:
        self.system, self.windows, self.missing = system, windows, missing
        self.chi2, self.strained = chi2, strained
        self.pushes = pushes_from(missing)
        self.body_pushes = pushes_of_bodies(system, missing)
        self.seconds = float(sum(c.t[-1] - c.t[0] for c in windows.commands))
        gaps = [np.diff(c.t) for c in windows.commands if len(c.t) > 1]
        self.interval = float(np.median(np.concatenate(gaps))) if gaps else 0.0

    def for_cause(self, cause: Cause) -> Hint:
        """Return the data for one cause: its command, and speeds of its joint."""
        joint = cause.joint or 0
        command = driving_command(self.system, joint, cause)
        values = np.concatenate([c.column(command) for c in self.windows.commands])
        of_body = cause.effect == "event" and cause.kind != "event"
        given, place = (self.body_pushes, cause.index) if of_body else (self.pushes, joint)
        pushes = tuple(p for p in given if p["place"] == place)
        return Hint(
            self.system,
            joint,
            values,
            self._speeds(joint),
            pushes,
            self.seconds,
            self.chi2,
            self.missing[joint],
            self.strained,
            self.interval,
            self.missing[joint].shifts,
        )

    def _speeds(self, joint: int) -> np.ndarray:
        windows, shows = self.windows, list(self.windows.shows)
        speed_state = self.system.joints + joint
        if speed_state in shows:
            c = shows.index(speed_state)
            if bool(windows.valid[:, c].any()):
                return windows.value[:, c][windows.valid[:, c]].numpy()
        c = shows.index(joint) if joint in shows else 0
        valid = windows.valid[:, c]
        pairs = valid[:, 1:] & valid[:, :-1]
        gap = (windows.t[:, c, 1:] - windows.t[:, c, :-1])[pairs]
        return ((windows.value[:, c, 1:] - windows.value[:, c, :-1])[pairs] / gap).numpy()


def pushes_from(missing: Sequence[MissingTorque]) -> tuple[dict[str, float], ...]:
    """Return starts of a push for each joint: the runs of slots where an outside load lowers chi2 most."""
    found = []
    for joint in missing:
        for width in WIDTHS:
            score = np.lib.stride_tricks.sliding_window_view(joint.score, width, axis=1).sum(-1)
            w, k = np.unravel_index(int(np.argmax(score)), score.shape)
            found.append(
                {
                    **dict.fromkeys(AXES, 0.0),
                    "torque": float(joint.single[w, k : k + width].mean()) / width,
                    "start": float(joint.time[w, k] - 0.5 * joint.slot),
                    "duration": width * joint.slot,
                    "log": float(joint.log[w]),
                    "place": float(joint.joint),
                }
            )
    return tuple(found)

"""A push: an outside torque on the joint that lasts for a while."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.identify.windows import Windows
from deepkoco.systems import Parameter, System

SHORTEST = 0.02  # [s]
LONGEST = 2.0  # [s]


class Push:
    """Names and bounds of a push's parameters.

    A push belongs to one log; times of different logs are told apart by ``log``, which is never fitted.
    """

    NAMES: ClassVar[tuple[str, ...]] = ("event.torque", "event.start", "event.duration", "event.log")

    @staticmethod
    def declared(system: System, windows: Windows) -> dict[str, Parameter]:
        """Parameters of a push during these windows."""
        scale = system.load_scale
        first = float(windows.t0.min()) - LONGEST if len(windows) else 0.0
        last = float(windows.t0.max()) + windows.length if len(windows) else 0.0
        listed = (
            Parameter("event.torque", 0.0, "N m", -10 * scale, 10 * scale, scale, "outside torque"),
            Parameter("event.start", first, "s", first, last, 1.0, "when the push begins, log time"),
            Parameter("event.duration", 0.1, "s", SHORTEST, LONGEST, 0.3, "how long it lasts"),
            Parameter("event.log", 0.0, "1", 0.0, 1e6, 1.0, "index of the log"),
        )
        return {p.name: p for p in listed}


def push_torque(windows: Windows, push: np.ndarray) -> Tensor | None:
    """Mean outside torque over each step, (L, W, n) [N m]; None where no lane is pushed.

    Args:
        windows: W windows of n steps.
        push: (L, 4) torque [N m], start [s], duration [s], log.
    """
    if not push[:, 0].any():
        return None
    node = windows.t0[:, None] + windows.step * np.arange(windows.steps + 1)
    torque, start, duration, log = (column[:, None, None] for column in push.T)
    covered = np.clip(node[None] - start, 0.0, duration)
    share = np.diff(covered, axis=-1) / windows.step
    mine = windows.log[None, :, None] == log
    return torch.from_numpy(torque * share * mine)

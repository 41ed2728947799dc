"""A push: a constant outside load on one joint for a limited time."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.systems import Parameter, System

SHORTEST = 0.02  # [s]
LONGEST = 2.0  # [s]


class Push:
    """Names and bounds of a push's parameters.

    A push acts on one joint in one log. Their indices ``event.joint`` and ``event.log`` are never fitted.
    """

    NAMES: ClassVar[tuple[str, ...]] = (
        "event.torque",
        "event.start",
        "event.duration",
        "event.log",
        "event.joint",
    )

    @staticmethod
    def declared(system: System, windows: Windows) -> dict[str, Parameter]:
        """Parameters of a push during these windows."""
        scale = max(system.load_scales)
        first = float(windows.t0.min()) - LONGEST if len(windows) else 0.0
        last = float(windows.t0.max()) + windows.length if len(windows) else 0.0
        unit = system.load_units[0]
        listed = (
            Parameter("event.torque", 0.0, unit, -10 * scale, 10 * scale, scale, "outside load"),
            Parameter("event.start", first, "s", first, last, 1.0, "when the push begins, log time"),
            Parameter("event.duration", 0.1, "s", SHORTEST, LONGEST, 0.3, "how long it lasts"),
            Parameter("event.log", 0.0, "1", 0.0, 1e6, 1.0, "index of the log"),
            Parameter("event.joint", 0.0, "1", 0.0, system.joints, 1.0, "index of the joint"),
        )
        return {p.name: p for p in listed}


def push_torque(windows: Windows, push: np.ndarray, joints: int = 1) -> Tensor | None:
    """Mean outside load over each step, (J, L, W, n) [N m or N]; None if no lane has a push.

    Args:
        windows: W windows of n steps.
        push: (L, 5) load, start [s], duration [s], log, joint.
        joints: Number J of joints.
    """
    if not push[:, 0].any():
        return None
    node = windows.t0[:, None] + windows.step * np.arange(windows.steps + 1)
    load, start, duration, log, joint = (column[:, None, None] for column in push.T)
    covered = np.clip(node[None] - start, 0.0, duration)
    share = np.diff(covered, axis=-1) / windows.step
    mine = windows.log[None, :, None] == log
    return torch.from_numpy(np.stack([load * share * mine * (joint == j) for j in range(joints)]))

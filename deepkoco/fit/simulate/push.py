"""A push: a constant outside load on one joint, or a constant force at one body, for a limited time."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.positions import positions_at
from deepkoco.fit.data.windows import Windows
from deepkoco.systems import Parameter, System
from deepkoco.systems.motion import POINT

SHORTEST = 0.02  # [s]
LONGEST = 5.0  # [s]
AXES = ("x", "y", "z")


class Push:
    """Names and bounds of a push's parameters.

    A push acts in one log, on one joint with ``event.torque``, or at one body with a force of fixed direction in the
    world. The indices ``event.place``, of the joint or of the body, and ``event.log`` are never fitted.
    """

    NAMES: ClassVar[tuple[str, ...]] = (
        "event.torque",
        "event.start",
        "event.duration",
        "event.log",
        "event.place",
        "event.x",
        "event.y",
        "event.z",
        *(f"event.{n}" for n in POINT),
    )
    FORCE: ClassVar[tuple[str, ...]] = NAMES[5:8]
    AT: ClassVar[tuple[str, ...]] = NAMES[8:]
    SIZES: ClassVar[tuple[str, ...]] = (NAMES[0], *FORCE)

    @staticmethod
    def declared(system: System, windows: Windows) -> dict[str, Parameter]:
        """Parameters of a push during these windows."""
        scale = max(system.load_scales)
        first = float(windows.t0.min()) - LONGEST if len(windows) else 0.0
        last = float(windows.t0.max()) + windows.length if len(windows) else 0.0
        unit = system.load_units[0]
        places = float(max(system.joints, len(system.push_places)))
        listed = (
            Parameter("event.torque", 0.0, unit, -10 * scale, 10 * scale, scale, "outside load"),
            *(_of_any_place(system, axis, "N", f"outside force along {axis} of the world") for axis in AXES),
            *(_of_any_place(system, name, "m", f"of the pushed point, {name} the link") for name in POINT),
            Parameter("event.start", first, "s", first, last, 1.0, "when the push begins, log time"),
            Parameter("event.duration", 0.1, "s", SHORTEST, LONGEST, 0.3, "how long it lasts"),
            Parameter("event.log", 0.0, "1", 0.0, 1e6, 1.0, "index of the log"),
            Parameter("event.place", 0.0, "1", 0.0, places, 1.0, "index of the joint or of the body"),
        )
        return {p.name: p for p in listed}


QUIET = dict.fromkeys(Push.SIZES, 0.0)  # no push


def _of_any_place(system: System, name: str, unit: str, text: str) -> Parameter:
    """A parameter of pushes at bodies, as wide as at the place where it is widest."""
    own = [p for place in system.push_places for p in place.parameters if p.name == name]
    low, high = min((p.low for p in own), default=-1.0), max((p.high for p in own), default=1.0)
    return Parameter(f"event.{name}", 0.0, unit, low, high, max((p.prior_sd for p in own), default=1.0), text)


def push_torque(windows: Windows, push: np.ndarray, system: System) -> Tensor | None:
    """Mean outside load over each step, (J, L, W, n) [N m or N]; None if no lane has a push.

    The load of a force at a body depends on the pose, which is the measured one: a simulation that follows the log is
    close to it, and a push is short.

    Args:
        windows: W windows of n steps.
        push: (L, P) values of `Push.NAMES`.
        system: The system with J joints.
    """
    own = dict(zip(Push.NAMES, push.T, strict=True))
    forced = np.any([own[n] != 0.0 for n in Push.FORCE], axis=0)
    if not (own["event.torque"].any() or forced.any()):
        return None
    node = windows.t0[:, None] + windows.step * np.arange(windows.steps + 1)
    load, start, duration, log, place = (
        own[f"event.{n}"][:, None, None] for n in ("torque", "start", "duration", "log", "place")
    )
    covered = np.clip(node[None] - start, 0.0, duration)
    share = np.diff(covered, axis=-1) / windows.step
    share *= windows.log[None, :, None] == log
    result = torch.from_numpy(np.stack([load * share * (place == j) for j in range(system.joints)]))
    for index in np.unique(own["event.place"][forced]).astype(int):
        lanes = np.flatnonzero(forced & (own["event.place"] == index))
        w, k = np.nonzero(share[lanes].any(0))
        if len(w):
            forces = torch.from_numpy(np.stack([own[n][lanes] for n in Push.FORCE]))
            point = torch.from_numpy(np.stack([own[n][lanes] for n in Push.AT]))
            positions = positions_at(windows, system, w, (k + 0.5) * windows.step)
            loads = system.loads_of_push(int(index), point[:, :, None], positions.unbind(0))  # (3, J, l, K)
            given = (forces[:, None, :, None] * loads).sum(0) * torch.from_numpy(share[lanes][:, w, k])
            for j in range(system.joints):
                result[j][torch.from_numpy(lanes)[:, None], torch.from_numpy(w), torch.from_numpy(k)] += (
                    given[j]
                )
    return result

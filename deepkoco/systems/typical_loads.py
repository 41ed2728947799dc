"""Typical loads of joints, from the equations: what gravity, springs and actuators make at rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from deepkoco.systems.motion import Motion

SAMPLES = 64
SLIDES = 0.5  # coordinates of a sliding joint are sampled within this distance of zero [m]
BEHIND = {"rad": 0.2, "m": 0.02}  # distance from its goal at which a servo works hard [rad or m]
UNMOVED = 10.0  # where nothing acts at rest: the load for this acceleration [rad/s2 or m/s2]
GROWS = 1.8  # times its change in half the range: the change of a load that grows with the way, as a spring's does
HALVINGS = 20  # of the range of a joint whose spring is stronger than its actuator


def typical_loads(system: Any) -> tuple[float, ...]:
    """Largest load of each joint at rest over positions and commands [N m or N].

    The loads are M a with the accelerations a at rest and the inertia matrix M, whose inverse is the answer of
    the accelerations to unit loads. For a pendulum this is its weight when horizontal, or what its motor delivers.
    A servo never stands as far from its goal as the range of goals is wide: a turntable that may turn for sixteen
    turns would have a typical load of a thousand times its friction. Goals are taken near the positions. Nor does a
    joint stand where a spring is stronger than what drives it: a voice coil on flexures moves by millimetres.

    Args:
        system: A system; joints that take no loads get the largest of the others.
    """
    joints, taken = system.joints, list(system.loaded_joints)
    if not taken:
        return (1.0,) * joints
    draws = torch.rand(
        joints + len(system.commands),
        SAMPLES,
        generator=torch.Generator().manual_seed(0),
        dtype=torch.float64,
    )
    spans = [math.pi if unit == "rad" else SLIDES for unit in system.state_units[:joints]]
    rest = _RestLoads(system, taken, 2.0 * draws[:joints] - 1.0, draws[joints:].round())
    for _ in range(HALVINGS):
        strong = rest.spring_bound(spans)
        if not any(strong):
            break
        spans = [s / 2.0 if j in taken and strong[taken.index(j)] else s for j, s in enumerate(spans)]
    loads, inertia = rest(spans, rest.corners)
    found = loads.abs().nan_to_num(0.0, 0.0, 0.0).amax(0)
    own = inertia.diagonal(dim1=-2, dim2=-1).abs().nan_to_num(1.0).median(0).values
    scales = torch.where(found > 1e-9 * own, found, UNMOVED * own).tolist()
    largest = max(scales)
    return tuple(scales[taken.index(j)] if j in taken else largest for j in range(joints))


class _RestLoads:
    """Loads at rest of the joints that take loads.

    Args:
        system: The system.
        taken: Those joints.
        places: Positions (joints, SAMPLES) as shares of each joint's range.
        corners: 0 or 1 (commands, SAMPLES): the limit of each command that acts.
    """

    def __init__(self, system: Any, taken: list[int], places: Tensor, corners: Tensor) -> None:
        self.system, self.taken, self.places, self.corners = system, taken, places, corners

    def __call__(self, spans: Sequence[float], corners: Tensor) -> tuple[Tensor, Tensor]:
        """Return the loads (SAMPLES, L) [N m or N] and the inertia matrices (SAMPLES, L, L).

        Args:
            spans: Distance from zero within which each joint stands [rad or m].
            corners: As in the class.
        """
        system, joints = self.system, self.system.joints
        angles = tuple(place * span for place, span in zip(self.places, spans, strict=True))
        driven = dict(enumerate(system.command_joints))
        values = []
        for k, (c, u) in enumerate(zip(system.commands, corners, strict=True)):
            joint = driven.get(k)
            if joint is not None and joint < joints and c.unit == system.state_units[joint]:
                values.append(angles[joint] + BEHIND[c.unit] * (2.0 * u - 1.0))
            else:
                values.append(c.low + (c.high - c.low) * u)
        p = system.default_parameters()
        effort = system.actuate(system.effort_of(torch.stack(values, -1)), p)
        efforts = (effort,) if len(system.commands) == 1 else effort.unbind(-1)
        law, still = system.accelerations(p), (torch.zeros(SAMPLES, dtype=torch.float64),) * joints
        time = torch.zeros((), dtype=torch.float64)

        def answer(joint: int | None) -> Tensor:
            loads = tuple(torch.ones_like(still[0]) if j == joint else None for j in range(joints))
            found = law(Motion(angles, still, efforts, loads, time))
            return torch.stack([a.expand(SAMPLES) for a in found])[self.taken]

        rest = answer(None)
        lightness = torch.stack([answer(joint) - rest for joint in self.taken], -1).permute(1, 0, 2)
        inertia = torch.linalg.pinv(lightness)
        return (inertia @ rest.T[..., None])[..., 0], inertia

    def spring_bound(self, spans: Sequence[float]) -> list[bool]:
        """Return which of the loads grow with the way beyond what the actuators of their joint can overcome.

        The load of gravity on a link is largest half way and stays; that of an actuator is the same everywhere. A joint
        that nothing drives is moved by the actuators of others.
        """
        first, last = (self(spans, c)[0] for c in (self.corners, 1.0 - self.corners))
        power = ((first - last) / 2.0).abs().amax(0).tolist()
        halves = [s / 2.0 for s in spans]
        near = [self(halves, c)[0] for c in (self.corners, 1.0 - self.corners)]
        far, half = (_half_spread((x + y) / 2.0).tolist() for x, y in ((first, last), near))
        # What rounding leaves of an actuator at another joint is none.
        powers = [p if p > 1e-9 * f else 0.0 for p, f in zip(power, far, strict=True)]
        units = [self.system.state_units[j] for j in self.taken]
        others = [max(p for p, u in zip(powers, units, strict=True) if u == unit) for unit in units]
        powers = [p or other for p, other in zip(powers, others, strict=True)]
        return [0.0 < p < f and f > GROWS * h for p, f, h in zip(powers, far, half, strict=True)]


def _half_spread(loads: Tensor) -> Tensor:
    """Return half of the range (L,) of loads (SAMPLES, L) over positions."""
    loads = loads.nan_to_num(0.0, 0.0, 0.0)
    return (loads.amax(0) - loads.amin(0)) / 2.0

"""Whether the equations of a user's system run, over a batch, and take outside loads."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from deepkoco.own_objects import in_words
from deepkoco.systems.declaration import DeclarationError
from deepkoco.systems.motion import Motion

SAMPLES = 3
TOLERANCE = 1e-6  # relative, between a batch and its entries one by one


def check_equations(system: Any) -> None:
    """Evaluate the accelerations at a few states, as a batch and one by one, with and without loads.

    Raises:
        DeclarationError: They fail, are no finite numbers, mix the entries of a batch, or ignore a load.
    """
    who = type(system).__name__
    if not system.has_equations:
        raise DeclarationError(
            f"{who} has no equations: write accelerations(self, parameters), which returns a function of the "
            "motion, or derivative(self, state, effort, parameters)"
        )
    angles, speeds, efforts = _samples(system)
    batch = _accelerations(system, who, angles, speeds, efforts)
    for k in range(SAMPLES):
        single = _accelerations(
            system, who, *(tuple(x[k] for x in part) for part in (angles, speeds, efforts))
        )
        for name, all_of_them, one in zip(system.joint_names, batch, single, strict=True):
            if not torch.allclose(all_of_them.expand(SAMPLES)[k], one, rtol=TOLERANCE, atol=TOLERANCE):
                raise DeclarationError(
                    f"{who}: the acceleration of {name} is {all_of_them.expand(SAMPLES)[k]:.6g} in a "
                    f"batch of {SAMPLES} states and {one:.6g} alone; compute with torch, entry by entry"
                )
    for joint in system.loaded_joints:
        loads = tuple(
            torch.ones(SAMPLES, dtype=torch.float64) if j == joint else None for j in range(system.joints)
        )
        loaded = _accelerations(system, who, angles, speeds, efforts, loads)
        if torch.equal(loaded[joint].expand(SAMPLES), batch[joint].expand(SAMPLES)):
            raise DeclarationError(
                f"{who}: the accelerations ignore the outside load on {system.joint_names[joint]}, so it can have no "
                f"friction: add motion.load({joint}) to what acts on it"
            )


def _samples(system: Any) -> tuple[tuple[Tensor, ...], ...]:
    steps = torch.arange(SAMPLES, dtype=torch.float64)
    angles = tuple(0.3 + 0.17 * steps + 0.1 * j for j in range(system.joints))
    speeds = tuple(0.2 - 0.13 * steps + 0.07 * j for j in range(system.joints))
    efforts = tuple(0.5 * (c.low + c.high) + (c.high - c.low) * (0.1 + 0.05 * steps) for c in system.commands)
    return angles, speeds, efforts


def _accelerations(
    system: Any, who: str, angles: Any, speeds: Any, efforts: Any, loads: Any = None
) -> tuple[Tensor, ...]:
    time = torch.zeros((), dtype=torch.float64)
    try:
        found = system.accelerations(system.default_parameters())(
            Motion(angles, speeds, efforts, loads, time)
        )
    except DeclarationError:
        raise
    except Exception as error:
        count = f"a batch of {len(angles[0])} states" if angles[0].ndim else "one state"
        raise DeclarationError(f"{who}: its equations fail for {count}: {in_words(error)}") from error
    if (
        not isinstance(found, tuple)
        or len(found) != system.joints
        or not all(isinstance(a, Tensor) for a in found)
    ):
        kind = f"{len(found)} values" if isinstance(found, tuple | list) else type(found).__name__
        if not system.has_accelerations:
            raise DeclarationError(
                f"{who}: its derivative has the rates of {len(found)} speeds for {system.joints} "
                f"{'joint' if system.joints == 1 else 'joints'}; the state is all positions, then all speeds, and "
                f"its derivative has {2 * system.joints} entries along the last dimension"
            )
        raise DeclarationError(
            f"{who}: the accelerations are {kind}; return a tuple of {system.joints} tensors, one for each joint"
        )
    for name, value in zip(system.joint_names, found, strict=True):
        if value.shape not in (torch.Size(), angles[0].shape) or not torch.isfinite(value).all():
            raise DeclarationError(
                f"{who}: the acceleration of {name} is {value.tolist()} for the positions "
                f"{[a.tolist() for a in angles]}; give a finite number for each state"
            )
    return found

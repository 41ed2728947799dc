"""Readings of a supervisor as what a Gymnasium vector environment returns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import Tensor

from deepkoco.graph import GraphError

READINGS = ("observation", "reward", "terminated")


def check_readings(
    readings: Mapping[str, Tensor], supervisor: str, environments: int, shape: tuple[int, ...]
) -> None:
    """Check what a supervisor's `observe` reads.

    Args:
        readings: (B, ...) by name.
        supervisor: Its name.
        environments: Environments B.
        shape: Of one observation.

    Raises:
        GraphError: A reading is missing or has another shape.
    """
    wanted = {"observation": (environments, *shape), "reward": (environments,)}
    if "terminated" in readings:
        wanted["terminated"] = (environments,)
    for name, expected in wanted.items():
        there = readings.get(name)
        if there is None or tuple(there.shape) != expected:
            found = "is missing" if there is None else f"has shape {tuple(there.shape)}"
            raise GraphError(f'supervisor "{supervisor}": reading "{name}" {found}, not {expected}')


def further_readings(readings: Mapping[str, Tensor], environments: int) -> dict[str, Any]:
    """What goes to ``info``: readings that Gymnasium has no place for, each with who has it."""
    info: dict[str, Any] = {}
    for name, value in readings.items():
        if name not in READINGS:
            info |= {name: value.cpu().numpy().copy(), f"_{name}": np.ones(environments, bool)}
    return info

"""Shapes of actions: an array of the right size and another shape holds other actions."""

from __future__ import annotations

from typing import Any

import numpy as np


def check_shape(actions: Any, shape: tuple[int, ...] | None, environments: int | None = None) -> None:
    """Check what a step is given.

    Args:
        actions: One action, or with `environments` one for each.
        shape: What it must have: that of the action space; None: its actions are no arrays.
        environments: Environments B of a batch; None: a single environment.

    Raises:
        ValueError: It has another shape.
    """
    given = np.shape(actions)
    if shape is None or given == shape:
        return
    if environments is None:
        raise ValueError(f"the action has shape {given}; give shape {shape}")
    raise ValueError(
        f"the actions have shape {given}; give shape {shape}: "
        f"an action of shape {shape[1:]} for each of the {environments} environments"
    )

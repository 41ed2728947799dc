"""The checks that every environment of the package makes of an action: its shape, and that it is finite."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


class ActionError(ValueError):
    """An action has the wrong shape, or is no finite number."""


def check_finite_action(action: np.ndarray, batched: bool = False) -> None:
    """Refuse an action that holds NaN or infinity.

    Args:
        action: (...) of one environment, or (B, ...) of a batch.
        batched: Whether its first axis is the batch.

    Raises:
        ActionError: An entry is not finite; the message names it, and the environment of a batch.
    """
    # For the one number of a single joint the general check costs as much as the rest of a step.
    if math.isfinite(action.item()) if action.size == 1 else np.isfinite(action).all():
        return
    place = tuple(int(i) for i in np.argwhere(~np.isfinite(action))[0])
    where = f" of environment {place[0]}" if batched and len(action) > 1 else ""
    entry = "".join(f"[{i}]" for i in (place[1:] if batched else place))
    raise ActionError(
        f"action{where}{f' entry {entry}' if entry else ''} is {action[place]}; an actuator needs a finite number: "
        "look for NaN in the policy and in what it has observed"
    )


def check_shape(actions: Any, shape: tuple[int, ...] | None, environments: int | None = None) -> None:
    """Check what a step is given.

    Args:
        actions: One action, or with `environments` one for each.
        shape: What it must have: that of the action space; None: its actions are no arrays.
        environments: Environments B of a batch; None: a single environment.

    Raises:
        ActionError: It has another shape.
    """
    given = np.shape(actions)
    if shape is None or given == shape:
        return
    if environments is None:
        raise ActionError(f"the action has shape {given}; give shape {shape}")
    raise ActionError(
        f"the actions have shape {given}; give shape {shape}: "
        f"an action of shape {shape[1:]} for each of the {environments} environments"
    )

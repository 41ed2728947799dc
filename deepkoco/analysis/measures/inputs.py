"""The inputs of a model: their names, which belong to the task, and where the task's are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray


@dataclass(frozen=True)
class Inputs:
    """What is known of the N entries of an observation.

    Attributes:
        names: (N,).
        is_task: Which belong to the task (N,); None where task and distractors are mixed in every entry.
        place: Where the task's own entries are, in the task's order (n,); None where they are nowhere as such.
        listed: The order in which they are listed: the task's, then the distractors' (N,).
    """

    names: tuple[str, ...]
    is_task: NDArray[np.bool_] | None
    place: NDArray[np.int64] | None
    listed: NDArray[np.int64]


def describe_inputs(envs: VectorEnv, entries: int) -> Inputs:
    """Name the entries that the environments give to the agent.

    Args:
        envs: Environments that observe states, wrapped by distractors or not.
        entries: N, what the model takes; more than the environments give for a model with a history.

    Returns:
        Names by the task where it has some, else by number.
    """
    layer = find_layer(envs, "mixer")
    inner = envs if layer is None else layer.env
    size = int(np.prod(inner.single_observation_space.shape or (1,)))
    if int(np.prod(envs.single_observation_space.shape or (1,))) != entries:
        return Inputs(tuple(f"input {i}" for i in range(entries)), None, None, np.arange(entries))
    task = find_attribute(envs, "task")
    own = list(getattr(task, "observation_names", ()))[:size]
    if not own:
        names = [f"entry {i}" for i in range(size)]
    else:
        names = own + [f"past action {i}" for i in range(1, size - len(own) + 1)]
    if layer is None:
        return Inputs(tuple(names), np.ones(size, dtype=bool), np.arange(size), np.arange(size))
    order = layer.mixer.order
    if layer.mixer.rotation is not None:
        return Inputs(tuple(f"mixed {i}" for i in range(order.size)), None, None, np.arange(order.size))
    names += [f"distractor {i}" for i in range(1, order.size - size + 1)]
    listed = np.argsort(order)
    return Inputs(tuple(names[i] for i in order), order < size, listed[:size], listed)


def find_layer(envs: VectorEnv, name: str) -> Any:
    """The wrapper or environment nearest to the agent that has an attribute of its own; None without one."""
    layer: Any = envs
    while True:
        if name in vars(layer) or hasattr(type(layer), name):
            return layer
        if not isinstance(layer, VectorWrapper):
            return None
        layer = layer.env


def find_attribute(envs: VectorEnv, name: str) -> Any:
    """An attribute of the wrappers or of the environments; None where nothing has it."""
    layer = find_layer(envs, name)
    if layer is not None:
        return getattr(layer, name)
    single = getattr(envs.unwrapped, "envs", None)  # Gymnasium's own vector environments hold single ones
    return getattr(single[0].unwrapped, name, None) if single else None

"""The contract of a node: its outputs and states keep the shape, type and keys that they start with."""

import cmath
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.model.node import GraphError


class NotFiniteError(ValueError):
    """A node put out NaN or infinity, or was given it as an action."""


class StepError(RuntimeError):
    """A node raised at a step of a batch of environments; the message names node and step."""

    @classmethod
    def of(cls, node: str, steps: np.ndarray, error: Exception) -> "StepError":
        """Describe an exception of a node, at the steps that its environments were at."""
        low, high = int(steps.min()), int(steps.max())
        where = f"its step {low}" if low == high else f"its steps {low} to {high}, by environment"
        return cls(f'node "{node}" at {where}: {type(error).__name__}: {error}')


def located(node: str, steps: np.ndarray, error: Exception) -> GraphError | StepError:
    """What to raise, from the original, where a node raised at the steps (B,) that its environments were at.

    What breaks the rules of a graph stays a GraphError; anything else becomes a StepError.
    """
    if isinstance(error, GraphError):
        return GraphError(f'node "{node}" at its step {steps.min()}: {error}')
    return StepError.of(node, steps, error)


def check_batch(what: str, value: Any, batch: int) -> None:
    """Check that a value has one entry for each environment.

    Args:
        what: name of the value, for the message.
        value: should be a tensor (B, ...).
        batch: B.

    Raises:
        GraphError: it is no tensor, or its first axis is another one.
    """
    if not isinstance(value, Tensor):
        raise GraphError(f"{what} is no tensor but {type(value).__name__}")
    if value.ndim == 0 or len(value) != batch:
        raise GraphError(
            f"{what} has shape {tuple(value.shape)}; the first axis must be the batch of {batch}"
        )


def check_output(output: Any, initial: Tensor) -> None:
    """Check the output of a step (B, ...) against the initial output.

    Raises:
        GraphError: they differ in shape or type.
    """
    _check_like("output", output, "the initial output", initial)


def check_state(state: Any, before: Mapping[str, Tensor]) -> None:
    """Check the state that a step returns against the one that it was given, (B, ...) each.

    Raises:
        GraphError: they differ in keys, shapes or types.
    """
    if not isinstance(state, Mapping):
        raise GraphError(f"state is no dict but {type(state).__name__}")
    if state.keys() != before.keys():
        raise GraphError(f"state has the keys {sorted(state)}, before the step {sorted(before)}")
    for key, value in before.items():
        _check_like(f'state "{key}"', state[key], "before the step", value)


def check_action(supervisor: str, step: int, action: Tensor, initial: Tensor) -> None:
    """Check the shape of an action (B, M) that is given from outside; its type is the caller's choice.

    Raises:
        ValueError: it differs from that of the initial action.
    """
    if action.shape != initial.shape:
        raise ValueError(
            f'action of "{supervisor}" at its step {step} has shape {tuple(action.shape)}, '
            f"the initial action {tuple(initial.shape)}"
        )


def check_finite(what: str, value: Tensor) -> None:
    """Check that a value (1, ...) of one environment has neither NaN nor infinity.

    Args:
        what: name of the value, for the message.
        value: of any type; whole numbers are always finite.

    Raises:
        NotFiniteError: an entry is not finite; the message says which.
    """
    if not (value.is_floating_point() or value.is_complex()):
        return
    # One sum costs a third of the exact check; only a sum that overflows needs it.
    if cmath.isfinite(value.sum().item()):
        return
    wrong = torch.nonzero(~torch.isfinite(value[0])).tolist()
    if not wrong:
        return
    place = "".join(f"[{i}]" for i in wrong[0])
    entry = f"entry {place} is" if place else "is"
    more = f", as are {len(wrong) - 1} more" if len(wrong) > 1 else ""
    raise NotFiniteError(
        f"{what} {entry} {value[0][tuple(wrong[0])].item()}{more}; a node that says so on purpose has "
        "the class attribute finite = False"
    )


def _check_like(what: str, value: Any, where: str, expected: Tensor) -> None:
    if not isinstance(value, Tensor):
        raise GraphError(f"{what} is no tensor but {type(value).__name__}")
    if value.shape != expected.shape or value.dtype != expected.dtype:
        raise GraphError(f"{what} is {_described(value)}, {where} {_described(expected)}")


def _described(tensor: Tensor) -> str:
    return f"{tuple(tensor.shape)} {str(tensor.dtype).removeprefix('torch.')}"

"""Policies: what decides the supervisor's actions in a rollout."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from deepkoco.graph.execution.state import RuntimeState

PolicyFunction = Callable[[Mapping[str, Tensor], Mapping[str, Any]], Tensor]
"""From its parameters and what it sees, the readings of the supervisor or else its inputs, to actions (B, M)."""
Policy = PolicyFunction | nn.Module | Tensor


def as_function(
    policy: PolicyFunction | nn.Module, parameters: Mapping[str, Tensor] | None
) -> tuple[PolicyFunction, Mapping[str, Tensor]]:
    """A policy as a pure function and its parameters; a module is given the reading "observation"."""
    if not isinstance(policy, nn.Module):
        return policy, parameters or {}
    own = dict(policy.named_parameters()) | dict(policy.named_buffers())
    modes = tuple(module.training for module in policy.modules())
    return ModuleFunction(policy, modes), own if parameters is None else parameters


@dataclass(frozen=True)
class ModuleFunction:
    """A module as a function of its parameters; equal to that of the same module in the same mode.

    Attributes:
        module: the policy.
        modes: for it and each module in it, whether it is in training.
    """

    module: nn.Module
    modes: tuple[bool, ...]

    def __call__(self, parameters: Mapping[str, Tensor], seen: Mapping[str, Any]) -> Tensor:
        return torch.func.functional_call(self.module, dict(parameters), (seen["observation"],))


def given_actions(policy: Tensor, state: RuntimeState, steps: int, shape: tuple[int, ...]) -> Tensor:
    """Actions (steps, B, M) or (steps, 1, M), checked.

    Raises:
        ValueError: they are not as many as the steps, or do not fit.
    """
    if policy.ndim != len(shape) + 2 or policy.shape[0] != steps or policy.shape[2:] != shape:
        raise ValueError(
            f"actions {tuple(policy.shape)} for {steps} steps of actions {shape}; expected (steps, B or 1, ...)"
        )
    if policy.shape[1] not in (1, state.batch):
        raise ValueError(f"actions for {policy.shape[1]} of {state.batch} environments")
    return policy


def given_signals(signals: Mapping[str, Tensor], state: RuntimeState, steps: int) -> Mapping[str, Tensor]:
    """Signals (steps, B or 1, ...) that a policy is shown beside the readings, checked.

    Raises:
        ValueError: they are not as many as the steps or the environments, or have the name of a reading.
    """
    for name, value in signals.items():
        if value.ndim < 2 or value.shape[0] != steps or value.shape[1] not in (1, state.batch):
            raise ValueError(
                f'signal "{name}" {tuple(value.shape)} for {steps} steps of {state.batch} environments; '
                "expected (steps, B or 1, ...)"
            )
        if name in state.readings:
            raise ValueError(f'signal "{name}" has the name of a reading')
    return signals


def signals_at(signals: Mapping[str, Tensor], k: int, batch: int) -> dict[str, Tensor]:
    """What a policy is shown at step k, (B, ...) by name."""
    return {name: signal[k].expand(batch, *signal.shape[2:]) for name, signal in signals.items()}


def recorded_names(record: tuple[str, ...] | None, state: RuntimeState) -> tuple[str, ...]:
    """Names of what a rollout records; None: the action and every reading.

    Raises:
        ValueError: a name is no reading.
    """
    known = ("action", *state.readings)
    for name in record or ():
        if name not in known:
            raise ValueError(f'"{name}" is no reading; known: {", ".join(known)}')
    return known if record is None else tuple(dict.fromkeys(record))

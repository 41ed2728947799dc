"""What is known to differ from log to log: the payload of one, the friction of another."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.logs.recording import LogError, Recording
from deepkoco.systems import ExtendedSystem, Parameters, System
from deepkoco.systems.effects import effects_of

KEY = "known"  # of a recording's meta data
PLACES = ("body", "load")  # where effects act that may differ from log to log

Known = tuple[Mapping[str, float], ...]


def known_of(recordings: Sequence[Recording], system: System) -> Known:
    """What each log says to be known of it: parameter -> amount by which it differs from the other logs.

    Raises:
        LogError: A name is no parameter of the system or of an effect on its body or joints, or no number is given.
    """
    names = may_differ(system)
    return tuple(
        _checked(r.meta.get(KEY), names, str(r.path or "the recording"), system.name) for r in recordings
    )


def may_differ(system: System) -> set[str]:
    """Parameters that can be known to differ from log to log: the system's own, and those of effects in `PLACES`."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    names = {p.name for p in base.parameters}
    for placed in effects_of(base).values():
        if placed.effect.place in PLACES:
            names |= {f"{placed.name}.{p.name}" for p in placed.parameters(base)}
    return names


def _checked(known: Any, names: set[str], where: str, system: str) -> dict[str, float]:
    if known is None:
        return {}
    if not isinstance(known, Mapping):
        raise LogError(f"{where}: known: expected parameters and numbers, got {known!r}")
    for name, value in known.items():
        if name not in names:
            raise LogError(
                f'{where}: known: {system} has no parameter "{name}" that may differ from log to log'
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise LogError(
                f"{where}: known: {name}: expected a number in the parameter's unit, got {value!r}"
            )
    return {str(name): float(value) for name, value in known.items() if value != 0}


def effects_in(known: Known) -> set[str]:
    """Effects whose parameters differ from log to log."""
    return {name.split(".")[0] for own in known for name in own if "." in name}


def amounts(known: Known, fitted: Mapping[str, Tensor] | None = None) -> dict[str, Tensor]:
    """By how much the parameters of K logs differ: (K, 1) where it is known, (K, L) where it was fitted in L lanes.

    Args:
        known: What is known of each log.
        fitted: Parameter -> (K, L) amounts by which each log differs beside that.
    """
    names = dict.fromkeys(name for own in known for name in own)
    result = {
        n: torch.tensor([own.get(n, 0.0) for own in known], dtype=torch.float64)[:, None] for n in names
    }
    for name, amount in (fitted or {}).items():
        result[name] = result[name] + amount if name in result else amount
    return result


def of_windows(parameters: Parameters, differ: Mapping[str, Tensor], log: np.ndarray) -> Parameters:
    """Parameters, scalar or (L,), as they are in windows of the logs (W,): those that differ are (W, 1) or (W, L)."""
    which = torch.from_numpy(log)
    return {**parameters, **{n: torch.as_tensor(parameters[n]) + a[which] for n, a in differ.items()}}


def of_log(parameters: Parameters, differ: Mapping[str, Tensor], number: int) -> Parameters:
    """Parameters, scalar or (L,), as they are in one log: those that differ are (1,) or (L,)."""
    return {**parameters, **{n: torch.as_tensor(parameters[n]) + a[number] for n, a in differ.items()}}

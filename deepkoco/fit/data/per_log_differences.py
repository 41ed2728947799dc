"""Known differences of parameters between logs, such as another payload or friction."""

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
PLACES = ("body", "load")  # places of effects whose parameters can differ from log to log

Known = tuple[Mapping[str, float], ...]


def known_of(recordings: Sequence[Recording], system: System) -> Known:
    """Read the known differences of each log (key ``known``): parameter -> amount that is added to it.

    Raises:
        LogError: A name is not a parameter that can differ (:func:`may_differ`), or a value is not a finite number.
    """
    names = may_differ(system)
    return tuple(
        _checked(r.meta.get(KEY), names, str(r.path or "the recording"), system.name) for r in recordings
    )


def may_differ(system: System) -> set[str]:
    """Parameters that can differ from log to log: the system's own, and those of effects in `PLACES`."""
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
    """Sum of known and fitted differences of K logs: (K, 1) for known ones, (K, L) for those fitted in L lanes.

    Args:
        known: Known differences of each log.
        fitted: Parameter -> (K, L) fitted differences in addition to the known ones.
    """
    names = dict.fromkeys(name for own in known for name in own)
    result = {
        n: torch.tensor([own.get(n, 0.0) for own in known], dtype=torch.float64)[:, None] for n in names
    }
    for name, amount in (fitted or {}).items():
        result[name] = result[name] + amount if name in result else amount
    return result


def of_windows(parameters: Parameters, differ: Mapping[str, Tensor], log: np.ndarray) -> Parameters:
    """Values of parameters, scalar or (L,), in windows of the logs (W,); those that differ are (W, 1) or (W, L)."""
    which = torch.from_numpy(log)
    return {**parameters, **{n: torch.as_tensor(parameters[n]) + a[which] for n, a in differ.items()}}


def of_log(parameters: Parameters, differ: Mapping[str, Tensor], number: int) -> Parameters:
    """Values of parameters, scalar or (L,), in one log; those that differ are (1,) or (L,)."""
    return {**parameters, **{n: torch.as_tensor(parameters[n]) + a[number] for n, a in differ.items()}}

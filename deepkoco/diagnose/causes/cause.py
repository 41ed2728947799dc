"""What a cause is: a nested extension of the baseline, with what is needed to find and show it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from deepkoco.systems import System


class Motion(NamedTuple):
    """What the unit did, sampled over time: all (n,)."""

    time: np.ndarray  # [s]
    theta: np.ndarray  # [rad]
    omega: np.ndarray  # [rad/s]
    command: np.ndarray  # command's unit
    command_rate: np.ndarray  # per second


class Hint(NamedTuple):
    """What a cause may look at to choose its starts."""

    system: System
    command: np.ndarray  # all command values of the logs
    omega: np.ndarray  # first guess of speeds [rad/s]
    pushes: tuple[Mapping[str, float], ...]  # where an outside torque would help most


Axis = Literal["omega", "theta", "command", "time", "command_rate"]
Starts = Callable[[Hint], list[dict[str, float]]]


def from_null(hint: Hint) -> list[dict[str, float]]:
    """One start: the null value."""
    return [{}]


@dataclass(frozen=True)
class Cause:
    """One entry of the catalogue.

    Attributes:
        name: Name in reports.
        family: Group of causes that are alike.
        free: Full names of the parameters that it frees (``effect.parameter``).
        summary: One sentence for the report.
        advice: Experiment that tells it apart from its neighbours.
        axis: Quantity against which the residual torque shows it best.
        signature: Shape (n,) that the residual torque takes under a small dose of it.
        starts: Start values; several where the gradient vanishes at null or the cost has several minima.
        counted: Number of parameters that the penalty counts; None counts all.
        searched: Whether the cause was looked for at many places, which the penalty must pay for.
    """

    name: str
    family: str
    free: tuple[str, ...]
    summary: str
    advice: str
    axis: Axis
    signature: Callable[[Motion], np.ndarray]
    starts: Starts = from_null
    counted: int | None = None
    searched: bool = False

    @property
    def effect(self) -> str:
        """Name of the effect of :mod:`deepkoco.systems.effects` that carries it (or "event")."""
        return self.free[0].split(".")[0]

    @property
    def size(self) -> int:
        """Number of parameters that the penalty counts."""
        return len(self.free) if self.counted is None else self.counted

"""Named parameters of a system, with unit, bounds and prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

Parameters = Mapping[str, Tensor]


class ParameterError(ValueError):
    """A parameter name is unknown or its value is outside its bounds."""


@dataclass(frozen=True)
class Parameter:
    """One named physical quantity.

    Attributes:
        name: Name by which every part of the package speaks of it.
        value: Nominal value, in ``unit``.
        unit: SI unit as text, e.g. ``"kg m2"``.
        low: Smallest admissible value.
        high: Largest admissible value.
        prior_sd: Standard deviation of the prior around ``value``, in ``unit``.
        description: One phrase with the symbol of the equation.
        guessed: Whether nobody stated ``prior_sd`` for this machine: it is what parameters of this kind may be off by.
    """

    name: str
    value: float
    unit: str
    low: float
    high: float
    prior_sd: float
    description: str
    guessed: bool = False

    def __post_init__(self) -> None:
        if not (self.low <= self.value <= self.high):
            raise ParameterError(
                f"{self.name} = {self.value} {self.unit} is outside [{self.low}, {self.high}]"
            )
        if not self.prior_sd > 0:
            raise ParameterError(f"{self.name}: prior_sd must be positive, got {self.prior_sd}")

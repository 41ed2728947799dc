"""Columns that measure another quantity than their channel: the current of a motor whose command has no unit."""

from __future__ import annotations

from dataclasses import replace

from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.units import parse_unit

OF_A_DRIVE = (
    "current",
    "voltage",
)  # a torque or a force is not the number of a motor, but what its gear makes of it


def with_numbers_of_drives(proposal: Proposal) -> Proposal:
    """Return a proposal in which a command without a unit is the number of amperes or volts of its column.

    A motor of a model file takes a number. Where its gear is its torque constant, that is its current.
    """
    return replace(proposal, choices=tuple(_as_number(choice) for choice in proposal.choices))


def measures_another(choice: Choice) -> bool:
    """Whether a column measures another quantity than its channel, for which only the user knows a factor."""
    own, wanted = parse_unit(choice.unit).quantity, parse_unit(choice.channel.unit).quantity
    return choice.column is not None and own != wanted


def _as_number(choice: Choice) -> Choice:
    own, wanted = parse_unit(choice.unit), parse_unit(choice.channel.unit)
    number = choice.channel.kind == "command" and wanted.quantity == "ratio"
    if choice.column is None or not number or own.quantity not in OF_A_DRIVE:
        return choice
    factor = own.factor / wanted.factor
    return replace(
        choice,
        unit=choice.channel.unit,
        stated=False,
        scale=choice.scale * factor,
        offset=choice.offset * factor,
        reasons=(*choice.reasons, f"a number of {own.si}"),
    )

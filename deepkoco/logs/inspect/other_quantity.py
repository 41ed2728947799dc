"""Columns that measure another quantity than their channel: the current of a motor whose command has no unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.joints.log_joints import role_of, words_of
from deepkoco.logs.units import parse_unit
from deepkoco.systems import System

OF_A_DRIVE = ("current", "voltage")
MOTOR = "motor"
NUMBER_OF = "a number of"  # of reasons
LOADS = {"rad": "torque", "m": "force"}  # on a joint, by the unit of its position


def with_numbers_of_drives(system: System, proposal: Proposal) -> Proposal:
    """Return a proposal in which a command without a unit is the number of its column's unit, where that is sure.

    A motor of a model file takes a number. Where its gear is its torque constant, that is its current. A load on its
    joint is what the gear makes of the number; so the torque of a motor that moves a slide is the number itself, and a
    torque beside a hinge may be either, unless it is called that of a motor. A goal of a speed is that of a motor's
    shaft behind the gear of a servo.

    Args:
        system: The system.
        proposal: What was proposed for it.
    """
    joints = dict(zip((c.name for c in system.commands), system.command_joints, strict=False))
    loads = {name: LOADS.get(system.state_units[joint]) for name, joint in joints.items()}
    named = {name: words_of(system.joint_names[joint]) for name, joint in joints.items()}
    choices = tuple(
        _as_number(choice, loads.get(choice.channel.name), named.get(choice.channel.name, []))
        for choice in proposal.choices
    )
    return replace(proposal, choices=choices)


def measures_another(choice: Choice) -> bool:
    """Whether a column measures another quantity than its channel, for which only the user knows a factor."""
    own, wanted = parse_unit(choice.unit).quantity, parse_unit(choice.channel.unit).quantity
    return choice.column is not None and own != wanted


def _as_number(choice: Choice, load: str | None, joint: Sequence[str]) -> Choice:
    own, wanted = parse_unit(choice.unit), parse_unit(choice.channel.unit)
    number = choice.channel.kind == "command" and wanted.quantity == "ratio"
    asked = None if choice.column is None else role_of(choice.column)[0]
    said = set() if choice.column is None else set(words_of(choice.column.name)) - set(joint)
    of_a_drive = (
        own.quantity in OF_A_DRIVE
        or (load is not None and own.quantity in LOADS.values() and own.quantity != load)
        or (own.quantity == "torque" and MOTOR in said)
        or (asked == "goal speed" and own.quantity == "angular velocity")
    )
    if choice.column is None or not number or not of_a_drive:
        return choice
    factor = own.factor / wanted.factor
    return replace(
        choice,
        unit=choice.channel.unit,
        stated=False,
        scale=choice.scale * factor,
        offset=choice.offset * factor,
        reasons=(*choice.reasons, f"{NUMBER_OF} {own.si}"),
    )

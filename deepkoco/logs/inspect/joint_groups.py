"""Channels of a system by the joint that they belong to."""

from __future__ import annotations

from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel, System

RATES = {"angle": "angular velocity", "length": "velocity"}
Group = tuple[Channel | None, Channel | None, list[Channel]]


def joint_groups(system: System) -> list[Group]:
    """Position, speed and commands of each joint; channels without a joint form groups of their own."""
    quantity = {c.name: parse_unit(c.unit).quantity for c in system.measurements}
    positions = [c for c in system.measurements if quantity[c.name] in RATES]
    rates = [c for c in system.measurements if c not in positions]
    shown = _states(system)
    commands, driven = list(system.commands), system.command_joints
    groups: list[Group] = []
    for k, position in enumerate(positions):
        wanted = RATES[quantity[position.name]]
        joint = shown.get(position.name, k)
        same = (c for c in rates if quantity[c.name] == wanted and shown.get(c.name) == joint + system.joints)
        rate = next(same, None)
        if rate is None and not shown:
            rate = next((c for c in rates if quantity[c.name] == wanted), None)
        if rate is not None:
            rates.remove(rate)
        mine = [c for c, j in zip(system.commands, driven, strict=False) if j == joint and c in commands]
        commands = [c for c in commands if c not in mine]
        groups.append((position, rate, mine))
    groups += [(None, rate, []) for rate in rates]
    if commands and groups:
        groups[-1][2].extend(commands)
    return groups


def _states(system: System) -> dict[str, int]:
    """State that each measurement shows; empty where sensors show something of their own."""
    if not system.shows_states:
        return {}
    return dict(zip((c.name for c in system.measurements), system.measured_states, strict=True))

"""Position, speed and commands of each joint of a system."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel, System

if TYPE_CHECKING:
    pass
RATES = {"angle": "angular velocity", "length": "velocity"}


def joint_groups(system: System) -> list[tuple[Channel | None, Channel | None, list[Channel]]]:
    """Position, speed and commands of each joint; channels without a joint form groups of their own."""
    quantity = {c.name: parse_unit(c.unit).quantity for c in system.measurements}
    positions = [c for c in system.measurements if quantity[c.name] in RATES]
    rates = [c for c in system.measurements if c not in positions]
    groups: list[tuple[Channel | None, Channel | None, list[Channel]]] = []
    commands = list(system.commands)
    for k, position in enumerate(positions):
        wanted = RATES[quantity[position.name]]
        rate = next((c for c in rates if quantity[c.name] == wanted), None)
        if rate is not None:
            rates.remove(rate)
        mine = [commands[k]] if k < len(commands) else []
        groups.append((position, rate, mine))
    groups += [(None, rate, []) for rate in rates]
    left = commands[len(positions) :]
    if left and groups:
        groups[-1][2].extend(left)
    return groups

"""Counts of an encoder beside a measured speed: the speed tells how many of them are a turn."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.counts import PER_TURN, Counts, in_counts
from deepkoco.logs.inspect.evidence import Samples
from deepkoco.logs.units import factor_between
from deepkoco.systems import System

AGREES = 0.9  # agreement of the counts with the integral of the speed from which their ratio is taken
NEAR = 0.01  # difference from a usual number of counts; 4000 and 4096 are 2.4 % apart


def with_counts_of_speed(system: System, proposal: Proposal, samples: Mapping[str, Samples]) -> Proposal:
    """Give positions in whole numbers the usual number of counts per turn that their speed shows.

    The counts change by n / (2 pi) times the integral of the speed in rad/s, whatever the robot. Only a speed whose
    unit is stated tells n. A number that no usual encoder has stays open, because a gear may be between the two
    sensors.

    Args:
        system: The system, with measurements that show states.
        proposal: Its mapping.
        samples: Label -> stamps [s] and values of each column.
    """
    if not system.shows_states:
        return proposal
    names = dict(zip(system.measured_states, (c.name for c in system.measurements), strict=True))
    mapped = {c.channel.name: c for c in proposal.choices if c.column is not None}
    counted: dict[str, Choice] = {}
    for joint in range(system.joints):
        position, speed = (mapped.get(names.get(k, "")) for k in (joint, joint + system.joints))
        if position is None or speed is None or position.column is None or speed.column is None:
            continue
        if speed.stated and in_counts(position, samples[position.column.label]):
            per_turn = _usual(_per_turn(proposal, position, speed))
            if per_turn is not None:
                why = f'"{speed.column.name}" shows {per_turn} of them in a turn'
                counted[position.channel.name] = replace(
                    position, scale=Counts(per_turn, False).scale, reasons=(*position.reasons, why)
                )
    return replace(proposal, choices=tuple(counted.get(c.channel.name, c) for c in proposal.choices))


def _per_turn(proposal: Proposal, position: Choice, speed: Choice) -> float:
    """Counts of a turn by the relation of the two columns; 0 where they are not related."""
    assert position.column is not None
    assert speed.column is not None
    relation = proposal.relations.get((position.column.label, speed.column.label))
    if relation is None or not relation.agreement > AGREES:
        return 0.0
    return 2.0 * math.pi * relation.ratio / (speed.scale * factor_between(speed.unit, "rad/s"))


def _usual(per_turn: float) -> int | None:
    if not (math.isfinite(per_turn) and per_turn > 0.0):
        return None
    nearest = min(PER_TURN, key=lambda n: abs(math.log(per_turn / n)))
    return nearest if abs(math.log(per_turn / nearest)) < NEAR else None

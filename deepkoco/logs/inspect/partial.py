"""A sidecar for a log of which some channels were found: the user fills in the others."""

from __future__ import annotations

from deepkoco.logs.inspect.choice import Choice, Proposal, mapping_of
from deepkoco.logs.inspect.survey import Survey
from deepkoco.logs.sidecar import ChannelColumn, Column
from deepkoco.logs.unused import listed

OPEN = "CHOOSE"
"""Column of a channel that none fits. No log has it, so every command refuses the sidecar until it is replaced."""


def partial_mapping(survey: Survey, proposal: Proposal) -> dict[str, ChannelColumn]:
    """The channels that were found, and those that a mapping needs with :data:`OPEN` as column; {} if none was found.

    A channel is needed if it is a command without a default, or if no channel of its kind has a column. A sidecar
    without them would be read as the log of another motion, or not at all.
    """
    found = mapping_of(survey, proposal)
    if not found:
        return {}
    first = next(iter(found.values()))
    topic = OPEN if first.topic else ""
    time = None if topic else first.time
    channels = dict(found)
    for choice in _needed(proposal):
        channel = choice.channel
        channels[channel.name] = ChannelColumn(Column(OPEN, channel.unit), channel.kind, time, topic)
    return channels


def how_to_fill_in(survey: Survey, proposal: Proposal) -> str:
    """Comment of the sidecar: what to write for the channels that are open."""
    names = ", ".join(choice.channel.name for choice in _needed(proposal))
    unused = proposal.unused(survey)
    left = f" Columns that no channel has: {listed(unused)}." if unused else ""
    return (
        f"# No column fits {names}.{left}\n"
        f"# Replace {OPEN} by a column, and state the unit of scale x number + offset, which is the channel:\n"
        '# a pulse of 1500 +- 400 us is -1 to 1 with unit: "1", scale: 0.0025, offset: -3.75.\n'
    )


def _needed(proposal: Proposal) -> list[Choice]:
    there = {c.channel.kind for c in proposal.choices if c.column is not None}
    empty = [c for c in proposal.choices if c.column is None]
    # A command with a default may be left out beside others; without any, a driven log would be that of a free motion.
    optional = [c for c in empty if c.channel.kind != "command" or c.channel.default is not None]
    return [c for c in empty if c not in optional or c.channel.kind not in there]

"""Columns whose names say nothing, and the channels for which they alone are left."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from deepkoco.logs.inspect.channel_names import is_commanded
from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.names import COMMANDED
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel

GUESS = 0.5  # probability of a column that nothing speaks for but that no other is left


def with_what_is_left(survey: Survey, proposal: Proposal) -> Proposal:
    """Give a channel without a column the only column that is left for it.

    A log of a robot holds most of its channels, so a name that says nothing (``delta`` for an angle of steering) is no
    evidence against a column. A column is given only if it could be no other channel either.
    """
    choices = {c.channel.name: c for c in proposal.choices}
    used = {c.column.label for c in proposal.choices if c.column is not None}
    driven = {parse_unit(c.channel.unit).quantity for c in proposal.choices if c.channel.kind == "command"}
    columns = [c for c in survey.columns if c.kind == "number" and c.clock and c.label not in used]
    while True:
        empty = [c.channel for c in choices.values() if c.column is None and c.channel.default is None]
        could = {c.name: [k for k in columns if _could_be(k, c, driven)] for c in empty}
        sole = [c for c in empty if len(could[c.name]) == 1 and _claims(could[c.name][0], could) == 1]
        if not sole:
            return replace(proposal, choices=tuple(choices[c.channel.name] for c in proposal.choices))
        channel = sole[0]
        column = could[channel.name][0]
        columns.remove(column)
        choices[channel.name] = Choice(
            channel,
            column,
            column.hints.unit or channel.unit,
            column.hints.unit is not None,
            GUESS,
            ("no other column is left for it",),
        )


def _could_be(column: ColumnSurvey, channel: Channel, driven: Collection[str]) -> bool:
    hints, quantity = column.hints, parse_unit(channel.unit).quantity
    if hints.counting or (hints.unit is not None and parse_unit(hints.unit).quantity != quantity):
        return False
    if channel.kind == "command":
        return not hints.measured and hints.speaks_for(quantity) >= 0.0
    # A boat's speed is called u, as many commands are; its unit is that of no command of the system.
    letter = "u" in hints.words and not hints.wanted and not {*hints.words} & ({*COMMANDED} - {"u"})
    commanded = is_commanded(column) and not (letter and hints.unit is not None and quantity not in driven)
    return not commanded and (hints.unit is not None or hints.speaks_for(quantity) >= 0.0)


def _claims(column: ColumnSurvey, could: dict[str, list[ColumnSurvey]]) -> int:
    return sum(column in columns for columns in could.values())

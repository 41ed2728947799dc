"""A proposed mapping: which column is which channel, with unit, confidence and reasons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from deepkoco.logs.checks.channel_checks import TURNS
from deepkoco.logs.checks.derivative import Relation
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.sidecar import ChannelColumn, Column
from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel

if TYPE_CHECKING:
    from deepkoco.logs.inspect.joints.finding import JointFinding

ONE_SCALE = 1.2  # ratio up to which estimated scales of speeds are those of one unit
CONFIRMS = 0.9  # agreement of a position with its speed, from which the unit of both is right
SURE, LIKELY = 0.9, 0.6  # probabilities from which a choice is called sure or likely


@dataclass(frozen=True)
class Choice:
    """The column proposed for one channel.

    Attributes:
        channel: channel of the system.
        column: proposed column, None if none fits.
        unit: unit of the column's values.
        stated: whether the name of the column states the unit.
        probability: weight of the choice among all columns and "none".
        reasons: reasons in words.
        rival: label of the next best column, None if all others are much worse.
        scale, offset: factor, and what is added then, in the unit of the column.
        held: whether the equations of motion hold in the unit, and in no other.
    """

    channel: Channel
    column: ColumnSurvey | None
    unit: str
    stated: bool
    probability: float
    reasons: tuple[str, ...]
    rival: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    held: bool = False

    @property
    def sureness(self) -> str:
        """ "sure", "likely", "a guess" or "none"."""
        if self.column is None:
            return "none"
        return "sure" if self.probability >= SURE else "likely" if self.probability >= LIKELY else "a guess"


def with_one_scale(choices: Sequence[Choice]) -> list[Choice]:
    """Speeds whose scales were estimated and nearly agree, with the scale of the most finely resolved one.

    A recorder writes the speeds of all joints in one unit. The scale of a joint that turns slowly, in few steps of its
    unit, is the least certain.
    """
    free = [c for c in choices if c.column is not None and not c.stated and abs(c.scale) != 1.0]
    free = [c for c in free if parse_unit(c.channel.unit).quantity in ("angular velocity", "velocity")]
    sizes = [abs(c.scale) for c in free]
    if len(free) < 2 or max(sizes) > ONE_SCALE * min(sizes) or len({c.channel.unit for c in free}) > 1:
        return list(choices)
    best = abs(max(free, key=_steps).scale)
    return [replace(c, scale=math.copysign(best, c.scale)) if c in free else c for c in choices]


def _steps(choice: Choice) -> float:
    """Number of steps of its resolution that a column spans."""
    column = choice.column
    if column is None or column.low is None or column.high is None or not column.quantum:
        return 0.0
    return (column.high - column.low) / column.quantum


@dataclass(frozen=True)
class Proposal:
    """A mapping of a whole log.

    Attributes:
        system: name of the system.
        choices: one per channel, in the order of the system, commands last.
        time: unit of the times.
        score: sum of the evidence of all channels [nats].
        relations: labels (position, speed) -> relation of each compared pair.
        joints: what was found of each joint, for systems with named joints.
    """

    system: str
    choices: tuple[Choice, ...]
    time: str
    score: float
    relations: dict[tuple[str, str], Relation]
    joints: tuple[JointFinding, ...] = ()

    def complete(self, survey: Survey) -> bool:
        """Whether a measurement has a column, and a command too unless the log of this survey shows a free motion.

        It does where every command has a default and no column is left that may drive the joint: a name that says
        nothing of a command would else turn a driven log into one of a free motion.
        """
        kinds = {c.channel.kind for c in self.choices if c.column is not None}
        asked = {c.channel.kind for c in self.choices if c.channel.default is None}
        free = "command" not in asked and not self.unused(survey)
        return "measurement" in kinds and ("command" in kinds or free)

    def unused(self, survey: Survey) -> tuple[str, ...]:
        """Labels of the columns that vary, count nothing and are no channel."""
        used = {c.column.label for c in self.choices if c.column is not None}
        return tuple(
            c.label
            for c in survey.columns
            if c.kind == "number" and not c.hints.counting and c.label not in used
        )


def mapping_of(survey: Survey, proposal: Proposal) -> dict[str, ChannelColumn]:
    """Convert a proposal to channels of a sidecar; channels without a column are left out."""
    channels = {}
    named = {c.column.label for c in proposal.choices if c.column is not None and c.stated}
    # A shaft may turn any number of times; its speed says that its unit is right, where both state theirs.
    sure = {
        label
        for (label, rate), relation in proposal.relations.items()
        if {label, rate} <= named
        and relation.agreement > CONFIRMS
        and 1.0 / ONE_SCALE < relation.ratio < ONE_SCALE
    }
    for choice in proposal.choices:
        column = choice.column
        if column is None:
            continue
        clock = survey.clock(column)
        time = None
        if clock is not None:
            unit = proposal.time if not clock.named and clock.unit != "iso8601" else clock.unit
            usual = survey.log.table(column.topic).times[:1] == (clock.column,)
            time = None if column.topic and usual else Column(clock.column, unit)
        channels[choice.channel.name] = ChannelColumn(
            Column(column.name, choice.unit),
            choice.channel.kind,
            time,
            column.topic,
            scale=choice.scale,
            checked=column.label in sure and _turns(choice),
            offset=choice.offset,
        )
    return channels


def _turns(choice: Choice) -> bool:
    """Whether a column is an angle of so many turns that a reader doubts its unit."""
    unit, column = parse_unit(choice.unit), choice.column
    if column is None or column.low is None or column.high is None or unit.quantity != "angle":
        return False
    return abs(choice.scale) * unit.factor * (column.high - column.low) > TURNS


def restrict(proposal: Proposal, names: Sequence[str]) -> Proposal:
    """Restrict a proposal to these channels."""
    return replace(proposal, choices=tuple(c for c in proposal.choices if c.channel.name in names))

"""Propose which column is which channel of a system, with confidence and reasons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from deepkoco.logs.checks.derivative import Relation, slip
from deepkoco.logs.inspect.channel_names import is_commanded, named_after
from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.evidence import (
    AGREES,
    POSITIONS,
    Samples,
    Units,
    choose_units,
    derivatives,
    drives,
    factor_of,
)
from deepkoco.logs.inspect.joint_groups import RATES, joint_groups
from deepkoco.logs.inspect.joints.goals import track
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import factor_between, parse_unit
from deepkoco.systems import Channel, System

NOTHING = 2.0  # evidence for a channel without a column [nats]
SI_FIELDS = ("position", "velocity", "effort")  # of JointState
FOLLOWED = 5.0  # evidence of a goal that explains all of a position [nats]
BEST = 8  # largest number of columns that are tried for a measurement, the best names first


class Proposer:
    """Proposes mappings of one log. Columns are compared once for all systems."""

    def __init__(self, survey: Survey, samples: dict[str, Samples]) -> None:
        self.survey, self.samples = survey, samples
        self.columns = [c for c in survey.columns if c.usable and len(samples[c.label][0]) > 1]
        self.relations = derivatives(self.columns, samples)
        self._driven: dict[tuple[str, str | None, str], dict[str, float]] = {}
        self._for_commands: set[str] = set()  # labels of columns that the commands of a system need

    def propose(self, system: System) -> Proposal:
        """Propose a mapping for a system."""
        taken: set[str] = set()
        choices: list[Choice] = []
        score, time = 0.0, "s"
        self._for_commands = self._needed(system)
        for number, (position, rate, commands) in enumerate(joint_groups(system)):
            pair, units, gained = self._pair(position, rate, number, system, taken)
            score += gained
            time = units.time if units is not None else time
            choices += pair
            taken |= {c.column.label for c in pair if c.column is not None}
            for command in commands:
                choice, gained = self._command(command, pair, number, system, taken)
                choices.append(choice)
                score += gained
                if choice.column is not None:
                    taken.add(choice.column.label)
        order = {c.name: k for k, c in enumerate((*system.measurements, *system.commands))}
        choices.sort(key=lambda choice: order[choice.channel.name])
        return Proposal(system.name, tuple(choices), time, score, self.relations)

    def _needed(self, system: System) -> set[str]:
        """Labels of columns that no measurement may have: as many goals as there are commands of their quantity.

        The goal of a speed that is followed well is the derivative of the position nearly as much as the speed is.
        """
        asked = [parse_unit(c.unit).quantity for c in system.commands if c.default is None]
        goals: dict[str, list[str]] = {quantity: [] for quantity in asked}
        for column in self.columns:
            unit = column.hints.unit
            if unit is not None and is_commanded(column) and parse_unit(unit).quantity in goals:
                goals[parse_unit(unit).quantity].append(column.label)
        return {
            label
            for quantity, labels in goals.items()
            if len(labels) <= asked.count(quantity)
            for label in labels
        }

    def _pair(
        self, position: Channel | None, rate: Channel | None, joint: int, system: System, taken: set[str]
    ) -> tuple[list[Choice], Units | None, float]:
        channels = [(c, place) for c, place in ((position, 1), (rate, 2)) if c is not None]
        firsts, seconds = (self._ranked(c, joint, system, taken) for c in (position, rate))
        scored = []
        for (a, said_a, why_a), (b, said_b, why_b) in product(firsts, seconds):
            if a is not None and b is not None and a.label == b.label:
                continue
            more, why = self._derivative_evidence(a, b)
            scored.append((said_a + said_b + more, a, b, [*why_a, *why], [*why_b, *why]))
        scored.sort(key=lambda entry: -entry[0])
        best = scored[0]
        units = self._units(best[1], best[2], position, rate)
        choices = []
        for channel, place in channels:
            probability, rival = _weight(scored, place)
            column = best[place]
            unit = channel.unit if units is None else (units.position if place == 1 else units.speed)
            if column is not None and (units is None or best[3 - place] is None):
                unit = column.hints.unit or _lone_unit(column, channel)
            stated = column is not None and column.hints.unit is not None
            if column is not None and stated and factor_of(column.hints.unit or "") == factor_of(unit):
                unit = column.hints.unit or unit
            if column is not None and self._in_si(column):
                unit, stated = channel.unit, True
            choices.append(Choice(channel, column, unit, stated, probability, tuple(best[place + 2]), rival))
        both = units is not None and best[1] is not None and best[2] is not None
        return choices, units if both else None, best[0]

    def _in_si(self, column: ColumnSurvey) -> bool:
        """Whether a column is of a message that is in SI by its definition; a motor turns many radians there."""
        kind = self.survey.log.table(column.topic).kind
        return kind.rpartition("/")[2] == "JointState" and column.name.split("[")[0] in SI_FIELDS

    def _command(
        self, channel: Channel, pair: Sequence[Choice], joint: int, system: System, taken: set[str]
    ) -> tuple[Choice, float]:
        shares = self._shares(pair)
        followed = self._followed(channel, pair)
        top = max(shares.values(), default=0.0)
        scored = []
        for column, said, why in self._ranked(channel, joint, system, taken):
            share = 0.0 if column is None else shares.get(column.label, 0.0)
            more = 5.0 * share if top > 0.05 else 0.0
            if column is not None and top > 0.05 and share > 0.02:
                best = " (most of all)" if share == top else ""
                why = [
                    *why,
                    f"explains {100 * share:.0f} % of the motion that gravity and friction do not{best}",
                ]
            if column is not None and column.label in followed:
                more += FOLLOWED * followed[column.label]
                why = [*why, "the position follows it"]
            elif column is not None and followed:
                more -= FOLLOWED
            scored.append((said + more, column, None, why, []))
        scored.sort(key=lambda entry: -entry[0])
        probability, rival = _weight(scored, 1)
        column = scored[0][1]
        unit = channel.unit if column is None else column.hints.unit or channel.unit
        stated = column is not None and column.hints.unit is not None
        return Choice(channel, column, unit, stated, probability, tuple(scored[0][3]), rival), scored[0][0]

    def _followed(self, channel: Channel, pair: Sequence[Choice]) -> dict[str, float]:
        """Label of each column that the position follows as its goal -> share of the position that it explains."""
        position = next((c for c in pair if c.channel.unit == channel.unit and c.column is not None), None)
        if position is None or position.column is None or channel.unit not in ("rad", "m"):
            return {}
        own = self.samples[position.column.label]
        others = [c.label for c in self.columns if c.label != position.column.label and is_commanded(c)]
        found = {label: track(*own, *self.samples[label]) for label in others}
        return {label: r.explained for label, r in found.items() if r is not None and r.follows}

    def _shares(self, pair: Sequence[Choice]) -> dict[str, float]:
        """Column label -> share of the acceleration of a joint that it explains."""
        angle = next((c for c in pair if c.column is not None and c.channel.unit in ("rad", "m")), None)
        speed = next((c for c in pair if c.column is not None and c.channel.unit in ("rad/s", "m/s")), None)
        if angle is None or angle.column is None:
            return {}
        used = {c.column.label for c in pair if c.column is not None}
        key = (angle.column.label, speed.column.label if speed and speed.column else None, angle.unit)
        if key not in self._driven:
            t, value = self.samples[key[0]]
            turn = np.unwrap(value * factor_between(angle.unit, angle.channel.unit))
            inputs = {c.label: self.samples[c.label] for c in self.columns if c.label not in used}
            self._driven[key] = drives((t, turn), self.samples[key[1]] if key[1] else None, inputs)
        return self._driven[key]

    def _ranked(
        self, channel: Channel | None, joint: int, system: System, taken: set[str]
    ) -> list[tuple[ColumnSurvey | None, float, list[str]]]:
        """Columns by the evidence of name and kind, the best first, and "none" last."""
        if channel is None:
            return [(None, 0.0, [])]
        rows = []
        for column in self.columns:
            reserved = channel.kind == "measurement" and column.label in self._for_commands
            if column.label not in taken and not reserved:
                said, why = self._name_evidence(column, channel, joint, system)
                rows.append((column, said, why))
        rows = [
            (column, said - self._elsewhere(column, channel, said, system), why) for column, said, why in rows
        ]
        rows.sort(key=lambda row: -row[1])
        most = BEST if channel.kind == "measurement" else len(rows)
        return [*rows[:most], (None, NOTHING, [])]

    def _elsewhere(self, column: ColumnSurvey, channel: Channel, said: float, system: System) -> float:
        """By how much a column's name speaks more for a channel of another kind [nats]: ``T_steer`` is no angle."""
        joints = {
            c.name: k for k, (a, b, more) in enumerate(joint_groups(system)) for c in (a, b, *more) if c
        }
        quantity = parse_unit(channel.unit).quantity
        others = [
            self._name_evidence(column, other, joints[other.name], system)[0]
            for other in (*system.measurements, *system.commands)
            if other.default is None and parse_unit(other.unit).quantity != quantity
        ]
        return max(0.0, max(others, default=-math.inf) - said)

    def _name_evidence(
        self, column: ColumnSurvey, channel: Channel, joint: int, system: System
    ) -> tuple[float, list[str]]:
        hints, why = column.hints, []
        quantity = parse_unit(channel.unit).quantity
        if channel.default is not None:
            # A log can lack a channel with a default. Its column needs its own name and admissible values.
            inside = channel.low <= (column.low or 0.0) and (column.high or 0.0) <= channel.high
            named = bool({channel.name, f"{channel.name}d"} & set(hints.words))
            return (6.0, [f'its name contains "{channel.name}"']) if inside and named else (-6.0, [])
        fits = hints.unit is not None and parse_unit(hints.unit).quantity == quantity
        # A unit says what the column measures; a word of another quantity is then a name: the x of "sway_x_deg".
        score = max(hints.speaks_for(quantity), 0.0 if fits else -math.inf)
        if score > 0:
            why.append(f"its name means {quantity}")
        if hints.unit is not None:
            score += 3.0 if fits else -6.0
            if fits:
                why.append(f"its name contains {hints.unit}")
        if column.name == channel.name:
            score += 4.0
            why.append("it has the name of the channel")
        else:
            alike = named_after(column, channel, (*system.commands, *system.measurements))
            score += alike
            if alike > 1.0:
                why.append("its words are those of the channel")
        if channel.kind == "command":
            named = is_commanded(column)
            score += 1.0 * named - 0.5 * hints.measured
            # A command that is an angle is a goal, so its name must differ from that of the measured angle.
            score += (2.0 * named - 2.0 * (not named)) * (quantity in POSITIONS)
            if named:
                why.append("its name means a command")
            score -= 2.0 * ("feedforward" in hints.words or "ff" in hints.words)
        else:
            score += -5.0 * (hints.commanded or hints.wanted) + 1.0 * hints.measured
        if column.kind == "constant":
            score -= 4.0
        return score + self._numbered(column, joint, system), why

    def _numbered(self, column: ColumnSurvey, joint: int, system: System) -> float:
        """Evidence of the number or joint in a name [nats]; the k-th smallest number belongs to joint k."""
        numbers = sorted({c.hints.number for c in self.columns if c.hints.number is not None})
        named = list(
            dict.fromkeys(c.hints.joint for c in self.columns if c.hints.joint and c.hints.number is None)
        )
        if column.hints.number is not None and len(numbers) > 0:
            right = numbers.index(column.hints.number) == joint
            return (2.0 if right else -4.0) if system.joints > 1 else (0.2 if right else -1.0)
        if column.hints.joint in named:
            return 0.5 if named.index(column.hints.joint) == joint else -0.5
        return 0.0

    def _derivative_evidence(self, a: ColumnSurvey | None, b: ColumnSurvey | None) -> tuple[float, list[str]]:
        """Evidence that b is the derivative of a [nats], with the reason."""
        if a is None or b is None:
            return 0.0, []
        relation = self.relations.get((a.label, b.label))
        if relation is None:
            return (-0.5, []) if a.topic == b.topic else (-1.0, [])
        if relation.agreement < AGREES:
            return -4.0 * (AGREES - max(relation.agreement, 0.0)), []
        fit = f"ratio {relation.ratio:.3g}, agreement {relation.agreement:.2f}"
        said = f'"{b.name}" is the derivative of "{a.name}" ({fit})'
        known = relation.agreement > 0.9 and (0.8 < relation.ratio < 1.25 or slip(relation.ratio) is not None)
        return 6.0 * (relation.agreement - 0.5) + 3.0 * known, [said]

    def _units(
        self, a: ColumnSurvey | None, b: ColumnSurvey | None, position: Channel | None, rate: Channel | None
    ) -> Units | None:
        if a is None or b is None or position is None or rate is None:
            return None
        quantity = parse_unit(position.unit).quantity
        clock = self.survey.clock(a)
        if quantity not in POSITIONS or clock is None:
            return None
        relation = self.relations.get((a.label, b.label), Relation(math.nan, 0.0, 0.0, 0.0))
        time = clock.unit if clock.unit in ("s", "ms", "us", "ns") else "s"
        return choose_units(a, b, (quantity, RATES[quantity]), relation, time, clock.named)


def _weight(scored: list, place: int) -> tuple[float, str | None]:
    """Probability of the best column, each column with its best partner, and the next best column."""
    best: dict[str | None, float] = {}
    for entry in scored:
        label = None if entry[place] is None else entry[place].label
        best[label] = max(best.get(label, -math.inf), entry[0])
    winner = None if scored[0][place] is None else scored[0][place].label
    top = best[winner]
    total = sum(math.exp(score - top) for score in best.values())
    others = sorted(
        ((s, label) for label, s in best.items() if label not in (winner, None)), key=lambda e: -e[0]
    )
    rival = others[0][1] if others and top - others[0][0] < 4.0 else None
    return 1.0 / total, rival


def _lone_unit(column: ColumnSurvey, channel: Channel) -> str:
    """Unit of a position or speed without a partner: degrees if the range is too large for radians."""
    span = (column.high or 0.0) - (column.low or 0.0)
    return {"rad": "deg", "rad/s": "deg/s"}.get(channel.unit, channel.unit) if span > 150.0 else channel.unit

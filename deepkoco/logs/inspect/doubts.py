"""Describe possible mistakes in a log, each with advice."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from deepkoco.logs.checks.derivative import slip
from deepkoco.logs.inspect.choice import Choice, Proposal
from deepkoco.logs.inspect.clock import Clock
from deepkoco.logs.inspect.evidence import AGREES
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.runs import MARK
from deepkoco.logs.units import factor_between, known_units, parse_unit

FEW_TEXTS = 0.2  # share of cells below which text in a column is a mistake
MANY_LETTERS = 40  # of a cell that is shown
MANY = 8  # largest number of listed names
MANY_COUNTS = 50  # different whole numbers from which they are taken for counts
ROOM = 1.2  # times its limit that a command may reach
OFF = 0.25  # tolerance of the logarithm of a ratio of units
_RATE = {"rad": "rad/s", "m": "m/s"}


def doubts_of(survey: Survey, proposal: Proposal | None = None) -> list[str]:
    """Describe possible mistakes of clocks and columns, and with a proposal those of units and commands."""
    result = [*survey.log.notes]
    result += [f'topic "{topic}" is left out: {reason}' for topic, reason in survey.log.skipped.items()]
    mapped = (
        {c.column.topic for c in proposal.choices if c.column is not None} if proposal is not None else None
    )
    for topic, clocks in survey.clocks.items():
        if mapped is None or topic in mapped:
            for clock in clocks:
                result += _clock(survey, clock)
    columns = [c for c in survey.columns if mapped is None or c.topic in mapped]
    result += _columns(columns) + _few_texts(survey, columns)
    if proposal is not None:
        result += _units(survey, proposal) + _derivatives(survey, proposal) + _commands(survey, proposal)
        result += _joints(proposal)
    return result


def _clock(survey: Survey, clock: Clock) -> list[str]:
    where = f'time "{clock.column}"' + (f" of {clock.topic}" if clock.topic else "")
    result = []
    if not clock.named and clock.unit != "s":
        result.append(
            f"{where} has no unit in its name; its steps suggest {clock.unit}, which is used; check it"
        )
    if clock.resets:
        counted = f', which the column "{clock.counter}" counts' if clock.counter else ""
        remedy = (
            f"the clock begins again, so the log has {clock.runs} runs{counted}; diagnose and identify take all of "
            f"them, {survey.log.path.name}{MARK}{survey.run} is the one that is compared here"
            if clock.runs > 1
            else "sort or split the log"
        )
        result.append(f"{where} decreases at {survey.log.rows(clock.topic, clock.resets, MANY)}; {remedy}")
    if clock.duplicates:
        result.append(
            f"{where} repeats a stamp {clock.duplicates} times; a row that occurs twice is used once, a few rows that "
            "differ are taken as rows that came together, and of many that differ keep one"
        )
    if clock.missing:
        result.append(f"{where} has {clock.missing} rows without a stamp")
    if clock.gaps and clock.longest_gap_s and clock.rate_hz and clock.longest_gap_s * clock.rate_hz > 10:
        result.append(f"{where} has {clock.gaps} gaps, the longest {clock.longest_gap_s:.3g} s")
    return result


def _columns(columns: list[ColumnSurvey]) -> list[str]:
    result = []
    for kind, said in (
        ("constant", "never change"),
        ("text", "contain text"),
        ("empty", "contain no number"),
    ):
        names = [f'"{c.label}"' for c in columns if c.kind == kind]
        if names:
            listed = ", ".join(names[:MANY]) + (f" and {len(names) - MANY} more" if len(names) > MANY else "")
            verb = (
                said
                if len(names) > 1
                else {"never change": "never changes"}.get(said, said.replace("contain", "contains", 1))
            )
            result.append(f"{listed} {verb}")
    for column in columns:
        if column.usable and column.missing:
            burst = f", at most {column.longest_burst} in a row" if column.longest_burst > 1 else ""
            result.append(
                f'"{column.label}" has {column.missing} cells without a number in {column.bursts} places{burst}; '
                'reading needs fill "drop" or "hold"'
            )
        if column.far:
            result.append(
                f'"{column.label}" has {column.far} values far from all others; check whether they are glitches'
            )
    return result


def _few_texts(survey: Survey, columns: list[ColumnSurvey]) -> list[str]:
    """Where text stands in columns that otherwise contain numbers."""
    result = []
    for column in columns:
        if column.kind != "text":
            continue
        cells = pd.Series(survey.log.table(column.topic).frame[column.name])
        numbers = pd.Series(pd.to_numeric(cells, errors="coerce"))
        wrong = np.flatnonzero((cells.notna() & numbers.isna()).to_numpy())
        if 0 < len(wrong) < FEW_TEXTS * len(cells):
            shown = " ".join(str(cells.iloc[wrong[0]]).split())[:MANY_LETTERS]
            result.append(
                f'"{column.label}" is a column of numbers but for "{shown}" at '
                f"{survey.log.rows(column.topic, wrong, MANY)}; empty these cells, and read with fill"
            )
    return result


def _zero_of_counts(choice: Choice) -> str:
    """What to write of the zero of counts that never pass 0: of a sensor that counts from elsewhere than the model."""
    column = choice.column
    if (
        column is None
        or column.low is None
        or column.high is None
        or column.low <= 0.0 <= column.high
        or choice.offset
    ):
        return ""
    return f", and as offset minus the scale times the count at which {choice.channel.name} is 0"


def _units(survey: Survey, proposal: Proposal) -> list[str]:
    result = []
    for choice in proposal.choices:
        if choice.column is None:
            continue
        si = choice.channel.unit
        if parse_unit(choice.unit).quantity != parse_unit(si).quantity:
            result.append(
                f'"{choice.column.name}" is in {choice.unit}, and {choice.channel.name} of {proposal.system} is in '
                f"{si}{' (a number of its own, before gear and gain)' if si == '1' else ''}; write unit: {si} in the "
                f"sidecar, and as scale how many {si} one {choice.unit} is"
            )
            continue
        if choice.scale != 1.0 and not choice.stated and not proposal.joints:
            result.append(
                f'"{choice.column.name}" has whole numbers only, and {choice.reasons[-1]}; check it, and correct '
                f"the key scale: 2 pi / (counts per turn){_zero_of_counts(choice)}"
            )
        elif _counts(survey, choice):
            each = f"2 pi / (counts per turn), in {si}" if si.startswith("rad") else f"{si} per count"
            result.append(
                f'"{choice.column.name}" has whole numbers only ({choice.column.low:.6g} to '
                f"{choice.column.high:.6g}): are these counts of an encoder? Then write unit: {si}, and as scale {each}"
                f"{_zero_of_counts(choice)}"
            )
        elif not choice.stated and choice.unit != si:
            result.append(
                f'"{choice.column.name}" does not name its unit; its values suggest {choice.unit} and not {si} '
                f"({_range(choice)}); check it"
            )
        limit = max(abs(choice.channel.low), abs(choice.channel.high))
        top = abs(choice.scale) * _largest(choice) * factor_between(choice.unit, si)
        if choice.channel.kind == "command" and math.isfinite(limit) and top > 0:
            if top > 20.0 * limit:
                result.append(
                    f'"{choice.column.name}" reaches {_amount(top, si)}, {top / limit:.0f} times the limit of '
                    f"{proposal.system} ({_amount(limit, si)}); check its unit ({_smaller(si, top, limit)})"
                    + _steps(survey, choice, top, limit)
                )
            elif top < limit / 200.0:
                result.append(
                    f'"{choice.column.name}" reaches only {_amount(top, si)} of the limit {_amount(limit, si)} of '
                    f"{proposal.system}; check its unit, or give the ratio of a gear (key scale)"
                )
    return result


def _amount(value: float, si: str) -> str:
    """Return a value with its unit; a mere number has none."""
    return f"{value:.3g}" if si == "1" else f"{value:.3g} {si}"


def _smaller(si: str, top: float, limit: float) -> str:
    """Units in which a command that is far above its limit in SI would be near it, the nearest first."""
    alike = (u for u in known_units(parse_unit(si).quantity) if factor_between(u, si) < 1.0)
    sizes = {u: top * factor_between(u, si) / limit for u in alike}
    near = [u for u in sorted(sizes, key=lambda u: -sizes[u]) if sizes[u] <= ROOM]
    return ", ".join(near) or ", ".join(sizes)


def _steps(survey: Survey, choice: Choice, top: float, limit: float) -> str:
    """Advice for a command in whole numbers, such as those of a driver of 16 bits."""
    if choice.stated or choice.column is None:
        return ""
    _, value = survey.samples(choice.column)
    if not np.all(value == np.round(value)):
        return ""
    each = f"if these are the steps of a driver, write as scale how many {choice.channel.unit} one of them is"
    return f"; {each}: {abs(choice.scale) * limit / top:.6g} makes its largest value the limit"


def _counts(survey: Survey, choice: Choice) -> bool:
    """Whether a measurement without a stated unit has whole numbers only, many of them."""
    if choice.stated or choice.column is None or choice.channel.kind != "measurement" or choice.scale != 1.0:
        return False
    _, value = survey.samples(choice.column)
    return bool(np.all(value == np.round(value))) and len(np.unique(value)) > MANY_COUNTS


def _derivatives(survey: Survey, proposal: Proposal) -> list[str]:
    result = []
    found = [c for c in proposal.choices if c.column is not None]
    for first in found:
        for second in found:
            if (
                second.channel.unit != _RATE.get(first.channel.unit)
                or first.column is None
                or second.column is None
            ):
                continue
            relation = proposal.relations.get((first.column.label, second.column.label))
            # If joints move together, a speed can agree with several angles. Only the best one is checked.
            others = [
                proposal.relations.get((c.column.label, second.column.label)) for c in found if c.column
            ]
            if relation is None or any(o is not None and o.agreement > relation.agreement for o in others):
                continue
            clock = survey.clock(first.column)
            if relation is None or relation.agreement < AGREES or clock is None:
                continue
            ratio = relation.ratio * first.scale * factor_between(first.unit, first.channel.unit)
            ratio /= second.scale * factor_between(second.unit, second.channel.unit)
            if parse_unit(proposal.time).quantity == "time" and clock.unit in ("s", "ms", "us", "ns"):
                ratio /= factor_between(proposal.time, "s") / factor_between(clock.unit, "s")
            if ratio != 0 and abs(math.log(abs(ratio))) < OFF and ratio > 0:
                if second.unit not in ("rad/s", "m/s") and not second.stated:
                    raw = relation.ratio
                    result.append(
                        f'"{first.column.name}" changes by {raw:.4g} times the integral of "{second.column.name}": '
                        f"{second.unit} explains it; a gear ratio of {abs(raw):.3g} explains it too (then write unit "
                        f"{second.channel.unit} and scale {raw:.3g})"
                    )
                continue
            meaning = slip(ratio) or "check the units, or give a gear ratio by the key scale"
            result.append(
                f'"{first.column.name}" in {first.unit} changes by {ratio:.4g} times the integral of '
                f'"{second.column.name}" in {second.unit}, not by 1: {meaning}'
            )
    return result


def _commands(survey: Survey, proposal: Proposal) -> list[str]:
    result = []
    for choice in proposal.choices:
        if choice.channel.kind != "command" or choice.column is None:
            continue
        if choice.rival is not None and choice.sureness != "sure":
            result.append(
                f'"{choice.column.label}" and "{choice.rival}" could both be {choice.channel.name}; take what '
                "reaches the joint: a measured torque where a controller inside the drive adds to the command"
            )
    return result


def _joints(proposal: Proposal) -> list[str]:
    result = [
        f'joint {joint.model}: "{joint.log}" {note}' for joint in proposal.joints for note in joint.notes
    ]
    result += [f"{c.channel.name}: {why}" for c in proposal.choices if c.column is None for why in c.reasons]
    for what, names in (
        ("direction", [joint.model for joint in proposal.joints if not joint.sign_known]),
        ("zero", [joint.model for joint in proposal.joints if not joint.zero_known]),
    ):
        if names:
            key = "scale: -1" if what == "direction" else "offset"
            result.append(
                f"the {what} of {', '.join(names)} is not shown by this log and taken as the model's; compare a known "
                f"pose with the sensor, or give more logs with slow motions, and correct the key {key}"
            )
    return result


def _largest(choice: Choice) -> float:
    column = choice.column
    assert column is not None
    return max(abs(column.low or 0.0), abs(column.high or 0.0))


def _range(choice: Choice) -> str:
    column = choice.column
    assert column is not None
    return f"{np.format_float_positional(column.low or 0.0, 4)} to {np.format_float_positional(column.high or 0.0, 4)}"

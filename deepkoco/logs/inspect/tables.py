"""Format an inspection as tables for the terminal."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from deepkoco.logs.inspect.choice import Proposal
from deepkoco.logs.inspect.fitting import Fitting
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.logs.units import factor_between, parse_unit


def clock_table(survey: Survey) -> Table:
    """One row for each time column."""
    several = survey.log.has_topics
    left = ("topic", "time") if several else ("time",)
    table = _table(
        left,
        ("unit", "stamps", "rate\nHz", "jitter\nms", "seconds", "gaps", "longest\nms", "repeated", "resets"),
    )
    for clocks in survey.clocks.values():
        for clock in clocks:
            cells = [clock.topic] if several else []
            cells += [clock.column, clock.unit if clock.named else f"{clock.unit}?", str(clock.samples)]
            cells += [
                _number(clock.rate_hz),
                _number(clock.jitter_s, 1e3),
                f"{clock.seconds:.2f}",
                str(clock.gaps),
            ]
            cells += [_number(clock.longest_gap_s, 1e3), str(clock.duplicates), str(len(clock.resets))]
            table.add_row(*(Text(cell) for cell in cells))
    return table


def column_table(survey: Survey, proposal: Proposal | None) -> Table:
    """One row for each column except clocks; with the range in SI if the unit is known."""
    units = {c.column.label: c.unit for c in proposal.choices if c.column is not None} if proposal else {}
    several = survey.log.has_topics
    left = ("topic", "field") if several else ("column",)
    table = _table((*left, "type"), ("rows", "missing", "range", "in SI", "step", "held"))
    for column in survey.columns:
        if column.kind == "clock":
            continue
        cells = [column.topic] if several else []
        missing = f"{column.missing} in {column.bursts}" if column.missing else "0"
        raw = "" if column.low is None else f"{column.low:.4g} .. {column.high:.4g}"
        span = (column.high or 0.0) - (column.low or 0.0)
        step = f"{column.quantum:.3g}" if column.quantum > 1e-4 * span else ""
        cells += [column.name, column.kind, str(column.rows), missing, raw]
        cells += [_in_si(column, units.get(column.label)), step, f"{100 * column.held:.0f} %"]
        table.add_row(*(Text(cell) for cell in cells))
    return table


def proposal_table(fitting: Fitting) -> Table:
    """The proposed mapping with confidence and reasons."""
    proposal = fitting.proposal
    alike = f" (equally good: {', '.join(fitting.alike)})" if fitting.alike else ""
    table = Table(
        title=Text(f"proposed for {proposal.system}{alike}"),
        title_justify="left",
        box=None,
        padding=(0, 1, 0, 0),
    )
    for heading in ("channel", "column", "unit", "confidence", "reason"):
        table.add_column(heading, overflow="fold")
    for choice in proposal.choices:
        column = "-" if choice.column is None else choice.column.label
        unit = "" if choice.column is None else choice.unit if choice.stated else f"{choice.unit}?"
        sure = (
            choice.sureness
            if choice.column is None
            else f"{choice.sureness} ({100 * choice.probability:.0f} %)"
        )
        rival = f"; next best: {choice.rival}" if choice.rival else ""
        cells = (
            f"{choice.channel.name} ({choice.channel.kind})",
            column,
            unit,
            sure,
            "; ".join(choice.reasons) + rival,
        )
        table.add_row(*(Text(cell) for cell in cells))
    return table


def joint_table(proposal: Proposal) -> Table:
    """One row for each joint: name in the log, relation to its goal, direction and zero with what supports them."""
    table = Table(box=None, padding=(0, 1, 0, 0))
    for heading in (
        "joint",
        "in the log",
        "follows its goal",
        "direction",
        "zero",
        "direction and zero from",
    ):
        table.add_column(heading, overflow="fold")
    for joint in proposal.joints:
        track = joint.tracking
        follows = (
            "-"
            if track is None
            else f"{track.delay:.2f} s late, slope {track.slope:.2f}"
            if track.follows
            else "no"
        )
        cells = (
            joint.model,
            f"{joint.log} ({100 * joint.probability:.0f} %)",
            follows,
            ("same" if joint.sign > 0 else "opposite") + ("" if joint.sign_known else "?"),
            f"{joint.zero:.3g}" + ("" if joint.zero_known else "?"),
            f"{joint.why_sign}; {joint.why_zero}",
        )
        table.add_row(*(Text(cell) for cell in cells))
    return table


def _table(left: tuple[str, ...], right: tuple[str, ...]) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0))
    for heading in left:
        table.add_column(heading, overflow="fold")
    for heading in right:
        table.add_column(heading, justify="right")
    return table


def _in_si(column: ColumnSurvey, unit: str | None) -> str:
    unit = unit or column.hints.unit
    if unit is None or column.low is None or column.high is None:
        return ""
    si = parse_unit(unit).si
    factor = factor_between(unit, si)
    return f"{factor * column.low:.4g} .. {factor * column.high:.4g} {si}"


def _number(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.4g}"

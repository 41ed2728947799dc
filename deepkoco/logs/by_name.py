"""Map a log without a sidecar: columns with the names of the channels, in SI units."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from deepkoco.logs.formats.log_file import LogFile
from deepkoco.logs.formats.open_log import open_log
from deepkoco.logs.units import UnitError, parse_unit

Specs = Mapping[str, tuple[str, str]]
"""Name of a channel -> its unit and kind."""
GOALS = ("goal_{}", "cmd_{}", "command_{}", "target_{}")
"""Names of the column of a command, besides its own."""
MEASURED = {"q_": "position[{}]", "dq_": "velocity[{}]"}
"""Beginning of a measurement's name -> field of JointState, which is in SI by its definition."""
CLOCKS = ("t", "time", "t_s", "time_s", "t [s]", "time [s]", "time[s]", "t[s]")


def mapping_by_names(path: Any, specs: Specs) -> dict[str, Any] | None:
    """Content of a sidecar for a log whose columns have the names of the channels.

    Args:
        path: the log.
        specs: the channels of the system.

    Returns:
        The sidecar; None if no command or no measurement has a column of its name, if a name is there twice, or if
        the time is not known.

    Raises:
        LogError: the log cannot be read.
    """
    log = open_log(path)
    channels: dict[str, dict[str, Any]] = {}
    for name, (unit, kind) in specs.items():
        places = [place for wanted in wanted_names(name, kind) for place in _places(log, wanted)]
        if len(places) > 1:
            return None
        for topic, column in places:
            time = _time(log, topic)
            if time is None or not _same_unit(column, unit):
                return None
            place = {"topic": topic, "field": column} if topic else {"column": column}
            channels[name] = {**place, "unit": unit, "kind": kind, "time": time}
    kinds = {entry["kind"] for entry in channels.values()}
    if kinds != {"command", "measurement"}:
        return None
    result: dict[str, Any] = {"channels": channels}
    if not log.has_topics:
        result["time"] = next(iter(channels.values()))["time"]
    return result


def wanted_names(name: str, kind: str) -> Iterator[str]:
    """Names that a column of a channel may have."""
    yield name
    if kind == "command":
        yield from (form.format(name) for form in GOALS)
    else:
        yield from (
            form.format(name[len(start) :]) for start, form in MEASURED.items() if name.startswith(start)
        )


def _places(log: LogFile, column: str) -> Iterable[tuple[str, str]]:
    return [(topic, column) for topic, table in log.tables.items() if column in table.frame.columns]


def _time(log: LogFile, topic: str) -> dict[str, str] | None:
    table = log.tables[topic]
    if table.times:
        return {"column": table.times[0], "unit": "s"}
    clocks = [str(name) for name in table.frame.columns if str(name).lower() in CLOCKS]
    return {"column": clocks[0], "unit": "s"} if len(clocks) == 1 else None


def _same_unit(column: str, unit: str) -> bool:
    """Whether a unit in the column's name is the channel's."""
    inside = column[column.rfind("[") + 1 : -1] if column.endswith("]") else ""
    try:
        return not inside or parse_unit(inside) == parse_unit(unit)
    except UnitError:
        return True  # the name of a joint

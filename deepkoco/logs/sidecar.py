"""Sidecar of a log: maps columns to channels, with unit and kind."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from deepkoco.logs.formats.log_file import HEADER, RECEIVED, LogError
from deepkoco.logs.units import UnitError, parse_unit
from deepkoco.suggestion import did_you_mean
from deepkoco.yaml_file import YamlFileError, read_yaml, shown

__all__ = [
    "EXAMPLE",
    "ISO",
    "KINDS",
    "ChannelColumn",
    "Column",
    "LogError",
    "NoSidecarError",
    "Sidecar",
    "dump_sidecar",
    "load_sidecar",
    "sidecar_path",
]

KINDS = ("command", "measurement")
EXAMPLE = """
system: rod_pendulum
time: {column: t, unit: s}
channels:
  torque: {column: command, unit: N m, kind: command}
  theta: {column: theta, unit: rad, kind: measurement}"""


ISO = "iso8601"
"""Unit of a time column that contains dates like 2024-05-01T12:00:00.125."""


class NoSidecarError(LogError):
    """A log has no sidecar, and its columns are not called as the channels are."""

    def __init__(self, log: Path, file: Path, why: str | None = None, system: str | None = None) -> None:
        self.log, self.file = log, file
        doubt = "" if why is None else f" ({why})"
        # Where the system is known, the command writes all of it; the example is that of another system.
        by_hand = f", or pass a mapping:{EXAMPLE}" if system is None else ", and correct it there"
        super().__init__(
            f"{log}: no sidecar {file} maps its columns to channels{doubt}; write one with deepkoco inspect {log} "
            f"--system {system or 'SYSTEM'} --out {file}{by_hand}"
        )


@dataclass(frozen=True)
class Column:
    """One column of a file, its unit, and for a time column the offset that is added [s]."""

    name: str
    unit: str
    offset: float = 0.0


@dataclass(frozen=True)
class ChannelColumn:
    """Place of one channel in the files of a log.

    Attributes:
        value: column of its values, or field of the topic.
        kind: "command" or "measurement".
        time: its time column; None takes the usual time of the topic (header.stamp, else received).
        topic: its topic, empty for a file without topics.
        file: another file than the log, relative to its folder; None is the log.
        scale: factor of the values besides their unit: a gear ratio, or -1 for the other direction.
        offset: added to the scaled values, in the unit of the column: the zero of the model minus that of the sensor.
        checked: True if the user confirms the values; implausible values are then no error.
    """

    value: Column
    kind: str
    time: Column | None
    topic: str = ""
    file: str | None = None
    scale: float = 1.0
    checked: bool = False
    offset: float = 0.0


@dataclass(frozen=True)
class Sidecar:
    """Content of a sidecar.

    Attributes:
        source: name of the sidecar in messages.
        system: name of the system, None if it is not given.
        time: common time column, None if it is not given.
        channels: channel name -> its place.
        meta: further facts about the log.
        where: column -> value of the rows to read.
    """

    source: str
    system: str | None
    time: Column | None
    channels: dict[str, ChannelColumn]
    meta: dict[str, Any]
    where: dict[str, float] = field(default_factory=dict)


def sidecar_path(path: str | Path) -> Path:
    """Path of the sidecar of a log: same folder, same stem, suffix `.yaml`."""
    path = Path(path)
    return path.with_name(f"{path.name}.yaml") if path.is_dir() else path.with_suffix(".yaml")


def find_sidecar(log: str | Path) -> Path | None:
    """Sidecar of a log: its own, else that of its folder (`logs.yaml` beside the folder `logs`); None if both lack."""
    own = sidecar_path(log)
    folder = Path(log).absolute().parent
    common = folder.with_name(f"{folder.name}.yaml")
    return next((file for file in (own, common) if file.is_file()), None)


def load_sidecar(log: Path, mapping: Mapping[str, Any] | str | Path | None = None) -> Sidecar:
    """Read and check the sidecar of a log.

    Args:
        log: the log that the mapping belongs to.
        mapping: content or path of a sidecar; None takes the file beside the log, else that of its folder.

    Raises:
        LogError: the sidecar is missing, or a key, kind or unit in it is wrong.
    """
    if isinstance(mapping, Mapping):
        source, content = f"mapping of {log}", dict(mapping)
    else:
        file = (find_sidecar(log) or sidecar_path(log)) if mapping is None else Path(mapping)
        source = str(file)
        if not file.is_file():
            raise NoSidecarError(log, file)
        try:
            content = read_yaml(file)
        except YamlFileError as error:
            raise LogError(str(error)) from error
    return _parse(source, content)


def dump_sidecar(
    system: str | None,
    channels: Mapping[str, ChannelColumn],
    meta: Mapping[str, Any],
) -> str:
    """Write the content of a sidecar as YAML; the first channel's time column is the common one."""
    common = next(iter(channels.values())).time
    content: dict[str, Any] = {"system": system} if system else {}
    if common is not None:
        content["time"] = _time_entry(common)
    content["channels"] = {}
    for name, channel in channels.items():
        entry: dict[str, Any] = {"file": channel.file} if channel.file else {}
        place = {"topic": channel.topic, "field": channel.value.name}
        entry |= place if channel.topic else {"column": channel.value.name}
        entry |= {"unit": channel.value.unit, "kind": channel.kind}
        if channel.scale != 1.0:
            entry["scale"] = channel.scale
        if channel.offset:
            entry["offset"] = channel.offset
        if channel.time is not None and channel.time != common:
            alike = common is not None and (channel.time.unit, channel.time.offset) == (
                common.unit,
                common.offset,
            )
            entry["time"] = channel.time.name if alike else _time_entry(channel.time)
        if channel.checked:
            entry["checked"] = True
        content["channels"][name] = entry
    if meta:
        content["meta"] = dict(meta)
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _time_entry(time: Column) -> dict[str, Any]:
    entry: dict[str, Any] = {"column": time.name, "unit": time.unit}
    return entry | {"offset": time.offset} if time.offset else entry


def _parse(source: str, content: Any) -> Sidecar:
    optional = ("time", "system", "meta", "where")
    content = _keys(source, "the file", content, required=("channels",), optional=optional)
    if not isinstance(content["channels"], Mapping) or not content["channels"]:
        raise LogError(f"{source}: channels: name at least one channel, for example:{EXAMPLE}")
    given = content.get("time")
    common = None if given is None else _time(source, "time", given)
    channels = {str(n): _channel(source, f"channels.{n}", e, common) for n, e in content["channels"].items()}
    _refuse_mixed_units(source, channels)
    meta = content.get("meta") or {}
    if not isinstance(meta, Mapping):
        raise LogError(f"{source}: meta: expected keys and values, got {shown(meta)}")
    system = content.get("system")
    where = _where(source, content.get("where"))
    return Sidecar(source, None if system is None else str(system), common, channels, dict(meta), where)


def _channel(source: str, where: str, content: Any, common: Column | None) -> ChannelColumn:
    optional = ("column", "topic", "field", "joint", "time", "file", "scale", "checked", "offset")
    entry = _keys(source, where, content, required=("unit", "kind"), optional=optional)
    if entry["kind"] not in KINDS:
        raise LogError(f'{source}: {where}: kind "{entry["kind"]}" is none of {", ".join(KINDS)}')
    topic = str(entry["topic"]) if entry.get("topic") is not None else ""
    place = "field" if topic else "column"
    if entry.get(place) is None:
        raise LogError(f'{source}: {where}: key "{place}" is missing; for example:{EXAMPLE}')
    if entry.get("column" if topic else "field") is not None:
        raise LogError(f"{source}: {where}: give either a column, or a topic and a field")
    name = str(entry[place])
    if entry.get("joint") is not None:
        if not topic:
            raise LogError(
                f"{source}: {where}: joint: only a channel with a topic can have a joint; give the column"
            )
        name = f"{name}[{entry['joint']}]"
    value = _column(source, where, {"column": name, "unit": entry["unit"]})
    time = _own_time(source, where, entry.get("time"), common, bool(topic))
    scale, checked, file = entry.get("scale", 1.0), entry.get("checked", False), entry.get("file")
    if (
        isinstance(scale, bool)
        or not isinstance(scale, int | float)
        or not math.isfinite(scale)
        or scale == 0
    ):
        raise LogError(
            f"{source}: {where}: scale: {scale!r} is not a finite number other than 0; write for example 6.33 or -1"
        )
    offset = entry.get("offset", 0.0)
    if isinstance(offset, bool) or not isinstance(offset, int | float) or not math.isfinite(offset):
        raise LogError(f"{source}: {where}: offset: {offset!r} is not a finite number in {entry['unit']}")
    if not isinstance(checked, bool):
        raise LogError(f"{source}: {where}: checked: write true or false, got {shown(checked)}")
    if time is None and not topic:
        raise LogError(f'{source}: the file: key "time" is missing; for example:{EXAMPLE}')
    return ChannelColumn(
        value,
        entry["kind"],
        time,
        topic,
        None if file is None else str(file),
        float(scale),
        checked,
        float(offset),
    )


def _where(source: str, content: Any) -> dict[str, float]:
    if content is None:
        return {}
    wrong = not isinstance(content, Mapping) or any(
        isinstance(v, bool) or not isinstance(v, int | float) for v in content.values()
    )
    if wrong:
        raise LogError(
            f'{source}: where: expected columns and numbers, such as "episode: 0", got {shown(content)}'
        )
    return {str(name): float(value) for name, value in content.items()}


def _refuse_mixed_units(source: str, channels: Mapping[str, ChannelColumn]) -> None:
    units: dict[tuple[str | None, str, str], str] = {}
    for channel in channels.values():
        for column in (channel.value, channel.time):
            if column is None:
                continue
            first = units.setdefault((channel.file, channel.topic, column.name), column.unit)
            if first != column.unit:
                raise LogError(
                    f'{source}: column "{column.name}" has mixed units, {first} and {column.unit}; keep the unit '
                    "of its numbers"
                )


def _keys(
    source: str, where: str, content: Any, required: Sequence[str], optional: Sequence[str]
) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        raise LogError(
            f"{source}: {where}: expected keys and values, got {shown(content)}; for example:{EXAMPLE}"
        )
    for key in required:
        if content.get(key) is None:
            raise LogError(f'{source}: {where}: key "{key}" is missing; for example:{EXAMPLE}')
    unknown = [str(key) for key in content if key not in (*required, *optional)]
    if unknown:
        raise LogError(
            f'{source}: {where}: unknown key "{unknown[0]}"{did_you_mean(unknown[0], (*required, *optional)) or ";"} '
            f"known: {', '.join((*required, *optional))}"
        )
    return dict(content)


def _column(source: str, where: str, content: Any) -> Column:
    entry = _keys(source, where, content, required=("column", "unit"), optional=())
    if isinstance(entry["unit"], (list, tuple, Mapping)):
        raise LogError(
            f"{source}: {where}: one column has one unit, got {shown(entry['unit'])}; split the column"
        )
    try:
        parse_unit(entry["unit"])
    except UnitError as error:
        raise LogError(f'{source}: {where}: column "{entry["column"]}": {error}') from error
    return Column(str(entry["column"]), str(entry["unit"]))


def _own_time(source: str, where: str, content: Any, common: Column | None, topic: bool) -> Column | None:
    if content is None:
        return common
    if isinstance(content, str):
        known = topic and content in (HEADER, RECEIVED)
        return Column(
            content, "s" if known or common is None else common.unit, common.offset if common else 0.0
        )
    return _time(source, f"{where}.time", content)


def _time(source: str, where: str, content: Any) -> Column:
    if isinstance(content, str) and content in (HEADER, RECEIVED):
        return Column(content, "s")
    entry = _keys(source, where, content, required=("column", "unit"), optional=("offset",))
    offset = entry.get("offset", 0.0)
    if isinstance(offset, bool) or not isinstance(offset, int | float) or not math.isfinite(offset):
        raise LogError(f"{source}: {where}: offset: {offset!r} is not a finite number of seconds")
    if entry["unit"] == ISO:
        return Column(str(entry["column"]), ISO, float(offset))
    column = _column(source, where, {key: entry[key] for key in ("column", "unit")})
    if parse_unit(column.unit).quantity != "time":
        raise LogError(
            f'{source}: {where}: unit "{column.unit}" is not a unit of time; use s, ms, us, ns or {ISO}'
        )
    return Column(column.name, column.unit, float(offset))

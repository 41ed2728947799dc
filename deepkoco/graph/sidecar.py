"""The sidecar of a log: which column is which channel, in which unit, command or measurement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from deepkoco.graph.units import UnitError, parse_unit

KINDS = ("command", "measurement")
EXAMPLE = """
system: rod_pendulum
time: {column: t, unit: s}
channels:
  torque: {column: command, unit: N m, kind: command}
  theta: {column: theta, unit: rad, kind: measurement}"""


class LogError(ValueError):
    """A log or its sidecar cannot be used; the message names file, column and what to do."""


@dataclass(frozen=True)
class Column:
    """One column of the file and the unit it is written in."""

    name: str
    unit: str


@dataclass(frozen=True)
class ChannelColumn:
    """Where one channel is found in the file."""

    value: Column
    kind: str
    time: Column


@dataclass(frozen=True)
class Sidecar:
    """What the columns of a log mean."""

    source: str
    system: str | None
    time: Column
    channels: dict[str, ChannelColumn]
    meta: dict[str, Any]


def sidecar_path(path: str | Path) -> Path:
    """Return the place of the sidecar of a log: same folder, same stem, `.yaml`."""
    return Path(path).with_suffix(".yaml")


def load_sidecar(log: Path, mapping: Mapping[str, Any] | str | Path | None = None) -> Sidecar:
    """Read and check the sidecar of a log.

    Args:
        log: the log that the mapping belongs to.
        mapping: the content of a sidecar, or the path of one; None takes the file next to the log.

    Raises:
        LogError: no sidecar is there, or a key, kind or unit in it is wrong.
    """
    if isinstance(mapping, Mapping):
        source, content = f"mapping of {log}", dict(mapping)
    else:
        file = sidecar_path(log) if mapping is None else Path(mapping)
        source = str(file)
        if not file.is_file():
            raise LogError(
                f"{log}: no sidecar {file} says what its columns mean; write one or pass a mapping:{EXAMPLE}"
            )
        try:
            content = yaml.safe_load(file.read_text(encoding="utf-8"))
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise LogError(f"{source}: not readable as YAML: {error}") from error
    return _parse(source, content)


def dump_sidecar(system: str | None, channels: Mapping[str, ChannelColumn], meta: Mapping[str, Any]) -> str:
    """Write the content of a sidecar as YAML; the first channel's time column is the common one."""
    common = next(iter(channels.values())).time
    content: dict[str, Any] = {"system": system} if system else {}
    content["time"] = {"column": common.name, "unit": common.unit}
    content["channels"] = {}
    for name, channel in channels.items():
        entry = {"column": channel.value.name, "unit": channel.value.unit, "kind": channel.kind}
        if channel.time.name != common.name:
            entry["time"] = channel.time.name
        content["channels"][name] = entry
    if meta:
        content["meta"] = dict(meta)
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _parse(source: str, content: Any) -> Sidecar:
    content = _keys(source, "the file", content, required=("time", "channels"), optional=("system", "meta"))
    common = _column(source, "time", content["time"])
    if parse_unit(common.unit).quantity != "time":
        raise LogError(f'{source}: time: unit "{common.unit}" is no unit of time; use s, ms, us or ns')
    if not isinstance(content["channels"], Mapping) or not content["channels"]:
        raise LogError(f"{source}: channels: name at least one channel, for example:{EXAMPLE}")
    channels = {}
    for name, entry in content["channels"].items():
        where = f"channels.{name}"
        entry = _keys(source, where, entry, required=("column", "unit", "kind"), optional=("time",))
        if entry["kind"] not in KINDS:
            raise LogError(f'{source}: {where}: kind "{entry["kind"]}" is none of {", ".join(KINDS)}')
        value = _column(source, where, {key: entry[key] for key in ("column", "unit")})
        time = _own_time(source, where, entry.get("time"), common)
        channels[str(name)] = ChannelColumn(value, entry["kind"], time)
    _refuse_mixed_units(source, channels)
    meta = content.get("meta") or {}
    if not isinstance(meta, Mapping):
        raise LogError(f"{source}: meta: expected keys and values, got {meta!r}")
    system = content.get("system")
    return Sidecar(source, None if system is None else str(system), common, channels, dict(meta))


def _refuse_mixed_units(source: str, channels: Mapping[str, ChannelColumn]) -> None:
    units: dict[str, str] = {}
    for channel in channels.values():
        for column in (channel.value, channel.time):
            if units.setdefault(column.name, column.unit) != column.unit:
                raise LogError(
                    f'{source}: column "{column.name}" is given mixed units, {units[column.name]} and '
                    f"{column.unit}; keep the one it is written in"
                )


def _keys(
    source: str, where: str, content: Any, required: Sequence[str], optional: Sequence[str]
) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        raise LogError(f"{source}: {where}: expected keys and values, got {content!r}; for example:{EXAMPLE}")
    for key in required:
        if content.get(key) is None:
            raise LogError(f'{source}: {where}: key "{key}" is missing; for example:{EXAMPLE}')
    unknown = [str(key) for key in content if key not in (*required, *optional)]
    if unknown:
        raise LogError(
            f'{source}: {where}: unknown key "{unknown[0]}"; known: {", ".join((*required, *optional))}'
        )
    return dict(content)


def _column(source: str, where: str, content: Any) -> Column:
    entry = _keys(source, where, content, required=("column", "unit"), optional=())
    if isinstance(entry["unit"], (list, tuple, Mapping)):
        raise LogError(f"{source}: {where}: one column has one unit, got {entry['unit']!r}; split the column")
    try:
        parse_unit(entry["unit"])
    except UnitError as error:
        raise LogError(f'{source}: {where}: column "{entry["column"]}": {error}') from error
    return Column(str(entry["column"]), str(entry["unit"]))


def _own_time(source: str, where: str, content: Any, common: Column) -> Column:
    if content is None:
        return common
    if isinstance(content, str):
        return Column(content, common.unit)
    time = _column(source, f"{where}.time", content)
    if parse_unit(time.unit).quantity != "time":
        raise LogError(f'{source}: {where}.time: unit "{time.unit}" is no unit of time; use s, ms, us or ns')
    return time

"""Convert fields of messages to columns: `joints.position[2]`, or `position[shoulder]` if joints have names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from deepkoco.logs.formats.log_file import HEADER, RECEIVED, LogError, Table

MOST_ELEMENTS = 64
"""Longer lists (images, scans) are read only if one of their fields is requested."""
MOST_CELLS = 1 << 27
"""Largest number of values of a topic: messages times fields."""
NAME_LISTS = ("name", "names", "joint_names", "joints", "joint_name", "dof_names", "interface_names")
"""Fields with names of the elements of the lists beside and below them (JointState, JointTrajectory)."""
NANO = 10**9
_CHECKED = 4096  # messages after which the size is checked again
_RECENT = 10**8 * NANO  # stamps after 1973 count since 1970; earlier ones count from another start
_STAMPS = ({"sec", "nanosec"}, {"sec", "nsec"}, {"secs", "nsecs"})
_TOKEN = re.compile(r"([^.\[\]]+)|\[([^\]]*)\]")


class _Missing(Exception):
    """A message does not have the field."""


class TopicColumns:
    """Collects the messages of one topic.

    Args:
        kind: type of the messages.
        origin_ns: origin of the times [ns since 1970].
        fields: fields to read; None reads every number except those of long lists.
    """

    def __init__(self, kind: str, origin_ns: int, fields: Iterable[str] | None = None) -> None:
        self.kind, self.origin = kind, origin_ns
        chosen = None if fields is None else [field for field in dict.fromkeys(fields) if field != RECEIVED]
        self._paths = None if chosen is None else {field: parse_field(field) for field in chosen}
        self._received: list[int] = []
        self._columns: dict[str, list[tuple[int, Any]]] = {}
        self._stamps: dict[str, None] = {}
        self._left_out: dict[str, str] = {}

    def __len__(self) -> int:
        return len(self._received)

    def add(self, received_ns: int, message: Any) -> None:
        """Add one message: an object with fields, or a value of JSON.

        Raises:
            LogError: the table would have more than `MOST_CELLS` values.
        """
        row = len(self._received)
        if row % _CHECKED == 0:
            self._check_size()
        self._received.append(received_ns)
        for name, value in self._fields(message):
            self._columns.setdefault(name, []).append((row, value))

    def table(self) -> Table:
        """Convert the messages to a table, the usual time column first.

        Raises:
            LogError: the table would have more than `MOST_CELLS` values.
        """
        self._check_size()
        rows = len(self._received)
        received = np.array([stamp - self.origin for stamp in self._received], dtype=np.float64) / NANO
        columns: dict[str, Any] = {RECEIVED: received}
        absent: dict[str, np.ndarray] = {}
        for name, cells in self._columns.items():
            column, present = np.full(rows, None, dtype=object), np.zeros(rows, dtype=bool)
            for row, value in cells:
                column[row], present[row] = value, True
            columns[name] = _compact(column, present)
            if not present.all():
                absent[name] = ~present
        times = [name for name in self._stamps if name in columns and name not in absent]
        header = HEADER in times and bool(np.any(columns[HEADER] != columns[HEADER][0])) if rows else False
        ordered = [HEADER] if header else []
        ordered += [RECEIVED, *(name for name in times if name != HEADER)]
        return Table(pd.DataFrame(columns), self.kind, tuple(ordered), absent, dict(self._left_out))

    def _check_size(self) -> None:
        rows = len(self._received)
        if rows * len(self._columns) > MOST_CELLS:
            raise LogError(
                f"its {rows} messages have {len(self._columns)} different fields, more than {MOST_CELLS} values in "
                "all; name the fields that are channels in the mapping"
            )

    def _fields(self, message: Any) -> Iterator[tuple[str, Any]]:
        if self._paths is None:
            yield from self._walk("", message, ())
            return
        for name, path in self._paths.items():
            try:
                value = _resolve(message, path)
            except _Missing:
                continue
            stamp = _stamp(value)
            if stamp is not None:
                self._stamps[name] = None
                value = self._seconds(stamp)
            yield name, value

    def _walk(self, prefix: str, value: Any, names: Sequence[str]) -> Iterator[tuple[str, Any]]:
        stamp = _stamp(value)
        if stamp is not None:
            self._stamps[prefix] = None
            yield prefix, self._seconds(stamp)
            return
        members = _members(value)
        if members is not None:
            names = _names(members) or names
            for key, member in members.items():
                yield from self._walk(f"{prefix}.{key}" if prefix else key, member, names)
        elif isinstance(value, list | tuple | np.ndarray):
            if len(value) > MOST_ELEMENTS:
                self._left_out[prefix] = f"{len(value)} elements"
                return
            if len(value) and isinstance(value[0], str):
                return
            # The points of a trajectory follow each other in time, even if they are as many as its joints.
            keys = names if len(names) == len(value) and not _is_series(prefix) else range(len(value))
            for key, element in zip(keys, value, strict=True):
                yield from self._walk(f"{prefix}[{key}]", element, names)
        elif isinstance(value, bytes | bytearray):
            self._left_out[prefix] = f"{len(value)} bytes"
        else:
            yield prefix or "value", value

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self.origin if stamp_ns >= _RECENT else stamp_ns) / NANO


def parse_field(field: str) -> list[str]:
    """Split `joints.position[2]` into `joints`, `position`, `[2]`.

    Raises:
        LogError: the text is not a path of fields.
    """
    tokens, at = [], 0
    for match in _TOKEN.finditer(field):
        if field[at : match.start()] not in ("", "."):
            break
        tokens.append(match.group(1) if match.group(1) is not None else f"[{match.group(2)}]")
        at = match.end()
    if at != len(field) or not tokens:
        raise LogError(f'field "{field}" is not a path such as joints.position[2] or position[shoulder]')
    return tokens


def _resolve(message: Any, path: Sequence[str]) -> Any:
    value, names, before = message, (), ""
    for token in path:
        members = _members(value)
        if members is not None:
            names = _names(members) or names
        if token.startswith("["):
            value = _element(value, token[1:-1].strip(), () if before == "points" else names)
        elif members is not None and token in members:
            value = members[token]
        elif members is None and token == "value" and len(path) == 1:
            return value
        else:
            raise _Missing
        before = token
    return value


def _element(value: Any, key: str, names: Sequence[str]) -> Any:
    if not isinstance(value, list | tuple | np.ndarray):
        raise _Missing
    if key in names and len(names) == len(value):
        return value[list(names).index(key)]
    if not key.isdecimal() or int(key) >= len(value):
        raise _Missing
    return value[int(key)]


def _members(value: Any) -> dict[str, Any] | None:
    if isinstance(value, Mapping):
        return {str(key): member for key, member in value.items()}
    fields = getattr(type(value), "__dataclass_fields__", None)
    if fields is None:
        return None
    return {name: getattr(value, name) for name in fields if not name.startswith("__") and name != "_"}


def _is_series(field: str) -> bool:
    return field.rpartition(".")[2] == "points"


def _names(members: Mapping[str, Any]) -> Sequence[str]:
    for key in NAME_LISTS:
        found = members.get(key)
        if not isinstance(found, list | tuple) or not found:
            continue
        if all(isinstance(name, str) for name in found) and len(set(found)) == len(found):
            return found
    return ()


def _stamp(value: Any) -> int | None:
    """Stamp in ns if the value has fields of seconds and nanoseconds, else None."""
    members = _members(value)
    if members is None or set(members) not in _STAMPS:
        return None
    seconds, nanoseconds = (members[key] for key in sorted(members, key=len))
    whole = isinstance(seconds, int | np.integer) and isinstance(nanoseconds, int | np.integer)
    return int(seconds) * NANO + int(nanoseconds) if whole else None


def _compact(column: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Convert numbers to float64, NaN where missing; other values are not converted."""
    values = column[present]
    if all(isinstance(v, int | float | np.number | np.bool_) for v in values):
        result = np.full(len(column), np.nan)
        try:
            result[present] = values.astype(np.float64)
        except OverflowError:
            return column
        return result
    return column

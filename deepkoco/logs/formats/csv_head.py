"""What can stand around the header of a CSV: comments above it, and a row of units below it."""

from __future__ import annotations

import csv
import re
from typing import NamedTuple

from deepkoco.logs.units import UnitError, parse_unit

COMMENT = ("#", "%", "//")
DELIMITERS = ",;\t|"
NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|nan|NaN")


class Head(NamedTuple):
    """A CSV that begins with its header.

    Attributes:
        text: Text from the header on, with units in the names.
        ahead: Lines of the file that it lacks before its rows.
        notes: Sentences on what was read from where.
    """

    text: str
    ahead: int
    notes: tuple[str, ...]


def read_head(text: str) -> Head:
    """Take comments above the header away, and put a row of units into the names of the columns."""
    lines = text.split("\n")
    ahead, notes = _comments(lines)
    if ahead < 0:
        return Head(text, 0, ())
    header, rest = lines[ahead].strip(), lines[ahead + 1 :]
    if header.startswith(COMMENT):
        header = header.lstrip("#%/ \t")
        notes.append(f"read the names of the columns from the comment in line {ahead + 1}")
    names = _cells(header, header)
    units = _units(_cells(rest[0], header) if rest else [], names)
    second = _cells(rest[1], header) if len(rest) > 1 else []
    if units is not None and _numeric(second):
        delimiter = _delimiter(header)
        pairs = zip(names, units, strict=True)
        header = delimiter.join(f"{name} [{unit}]" if unit else name for name, unit in pairs)
        notes.append(f"read units of the columns from line {ahead + 2}")
        ahead, rest = ahead + 1, rest[1:]
    if not notes:
        return Head(text, 0, ())
    return Head("\n".join([header, *rest]), ahead, tuple(notes))


def _comments(lines: list[str]) -> tuple[int, list[str]]:
    """Index of the line of the header, and notes; -1 where no comment stands above it."""
    first = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith(COMMENT)), -1)
    if first <= 0 or not lines[0].startswith(COMMENT):
        return (0 if first == 0 else -1), []
    last = lines[first - 1].lstrip("#%/ \t")
    if _numeric(_cells(lines[first], lines[first])):
        # As numpy.savetxt writes it: the last comment has the names.
        same = len(_cells(last, lines[first])) == len(_cells(lines[first], lines[first]))
        return (first - 1 if same else -1), []
    return first, [f"left out {first} line{'s' * (first > 1)} of comments above the header"]


def _delimiter(line: str) -> str:
    return max(DELIMITERS, key=line.count)


def _cells(line: str, header: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=_delimiter(header)), [])]


def _numeric(cells: list[str]) -> bool:
    """Whether the cells of a row are numbers, up to a few of text."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and sum(NUMBER.fullmatch(cell) is not None for cell in filled) > 0.5 * len(filled)


def _units(cells: list[str], names: list[str]) -> list[str] | None:
    """Unit of each column; None where the cells are no row of units."""
    plain = [cell.strip("[]() ") for cell in cells]
    if len(plain) != len(names) or not any(plain):
        return None
    for cell in plain:
        try:
            parse_unit(cell)
        except UnitError:
            return None
        if NUMBER.fullmatch(cell) is not None:
            return None
    return plain

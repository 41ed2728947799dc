"""What other programs make of a CSV: comments above the header, a row of units below it, spaces between columns."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import NamedTuple

from deepkoco.logs.units import UnitError, parse_unit

COMMENT = ("#", "%", "//")
DELIMITERS = ",;\t|"
BEGINNING = 1 << 16  # bytes that tell a table from another text
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
    """Take comments above the header away, put a row of units into the names, and read spaces as tabs."""
    lines = text.split("\n")
    if spaced := _spaced(lines):
        lines = ["\t".join(line.lstrip("#%").split()) if line.strip() else line for line in lines]
        text = "\n".join(lines)
    ahead, notes = _comments(lines)
    notes += ["read spaces as the separators of the columns"] if spaced else []
    if ahead < 0:
        return Head(text, 0, tuple(notes))
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


def looks_like_table(path: Path) -> bool:
    """Whether a text begins with names of columns and a row of as many numbers; notes and lists of names do not."""
    try:
        with path.open("rb") as file:
            text = file.read(BEGINNING).decode("utf-8-sig", errors="replace").replace("\r\n", "\n")
    except OSError:
        return False
    lines = read_head(text).text.split("\n")
    if len(lines) < 2:
        return False
    names, numbers = _cells(lines[0], lines[0]), _cells(lines[1], lines[0])
    return len(names) > 1 and len(names) == len(numbers) and _numeric(numbers) and not _numeric(names)


def _spaced(lines: list[str]) -> bool:
    """Whether spaces alone stand between the names of the first line, and between as many numbers of the second."""
    if len(lines) < 2 or any(delimiter in line for line in lines[:2] for delimiter in DELIMITERS):
        return False
    names, numbers = lines[0].lstrip("#%").split(), lines[1].split()
    return len(names) > 1 and len(names) == len(numbers) and _numeric(numbers) and not _numeric(names)


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

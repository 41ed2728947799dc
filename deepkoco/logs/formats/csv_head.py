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
DATE = re.compile(r"\d{4}-\d\d?-\d\d?([T ]\S+)?|\d\d?:\d\d(:\d\d([.,]\d+)?)?")
LIST = re.compile(r"\[.*\]")
ROWS = 20  # rows that tell a table in which numbers are few from a text


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
    spaced = _spaced(lines)
    if spaced is not None:
        # The comments above the header stay as they are; so does the sign of a header below them.
        sign = "#" if spaced > 0 and lines[spaced].startswith(COMMENT) else ""
        below = ["\t".join(line.split()) if line.strip() else line for line in lines[spaced + 1 :]]
        header = "\t".join(_without_sign(lines[spaced]).split())
        lines = [*lines[:spaced], f"{sign}{header}", *below]
        text = "\n".join(lines)
    ahead, notes = _comments(lines)
    notes += ["read spaces as the separators of the columns"] if spaced is not None else []
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


def with_line_ends(text: str) -> str:
    """The text with line feeds where lines end in carriage returns alone; next to line feeds these end no line."""
    return text if "\n" in text else text.replace("\r", "\n")


def looks_like_table(path: Path) -> bool:
    """Whether a text begins with names of columns and rows of as many cells; notes and lists of names do not.

    Half of a row are numbers, dates or lists of numbers, and those stand in the same columns of the rows below it.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(BEGINNING)
    except OSError:
        return False
    text = with_line_ends(raw.decode("utf-8-sig", errors="replace").replace("\r\n", "\n"))
    if len(raw) == BEGINNING:
        text = text[: text.rfind("\n") + 1]  # the last line may be cut off
    try:
        lines = read_head(text).text.split("\n")
        names, *rows = [_cells(line, lines[0]) for line in lines[: ROWS + 1] if line.strip()] or [[]]
    except csv.Error:  # a carriage return in a line, as progress bars write
        return False
    if len(names) < 2 or _share(names) > 0.5 or not rows or _share(rows[0]) < 0.5:
        return False
    if _share(rows[0]) > 0.5:
        return len(rows[0]) == len(names)
    places = [k for k, cell in enumerate(rows[0]) if _is_value(cell)]
    return all(
        len(row) == len(names) and all(_is_value(row[k]) or not row[k] for k in places) for row in rows
    )


def _spaced(lines: list[str]) -> int | None:
    """Index of the header where spaces alone stand between its names, and between as many numbers of the line below it.

    The header is the first line that is no comment, or the last one of the comments above the numbers.
    """
    first = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith(COMMENT)), 0)
    header = first - 1 if first > 0 and _numeric(lines[first].split()) else first
    both = lines[header : header + 2]
    if len(both) < 2 or any(delimiter in line for line in both for delimiter in DELIMITERS):
        return None
    names, numbers = _without_sign(both[0]).split(), both[1].split()
    fits = len(names) > 1 and len(names) == len(numbers) and _numeric(numbers) and not _numeric(names)
    return header if fits else None


def _without_sign(line: str) -> str:
    """A line without the sign of a comment at its beginning."""
    return re.sub(r"^(#|%|//)+\s*", "", line)


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
    return _share(cells) > 0.5


def _share(cells: list[str]) -> float:
    """Share of a row's filled cells that are values."""
    filled = [cell for cell in cells if cell]
    return sum(map(_is_value, filled)) / len(filled) if filled else 0.0


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, a date, a time of the day or a list of numbers."""
    return any(kind.fullmatch(cell) is not None for kind in (NUMBER, DATE, LIST))


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

"""Limit the size of definitions of ROS messages, from which the library generates a program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from deepkoco.logs.formats.log_file import LogError

LONGEST_DEFINITION = 1 << 18  # longest definition that is parsed [characters]
MOST_LINES = 2048
"""Largest number of lines of the program for a type: one per field, and per text or message in a fixed array."""
MOST_ELEMENTS = 1 << 20
"""Largest number of elements of a message with all messages in it; lists of varying length count once."""
_BASE, _NAME, _ARRAY = 1, 2, 3
Definitions = Mapping[str, Any]


def check_text(name: str, text: str) -> None:
    """Refuse a definition that is too long to be parsed in reasonable time.

    Raises:
        LogError: the definition is longer than `LONGEST_DEFINITION`.
    """
    if len(text) > LONGEST_DEFINITION:
        raise LogError(
            f'the definition of "{name}" has {len(text)} characters, more than the limit {LONGEST_DEFINITION}'
        )


def check_size(name: str, definitions: Definitions) -> None:
    """Refuse a type whose program or message would be too large.

    Args:
        name: name of the type.
        definitions: type name -> constants and fields, as parsed by the library.

    Raises:
        LogError: the type is too large, or contains itself.
    """
    _elements(name, definitions, (), {})


def _elements(name: str, definitions: Definitions, above: tuple[str, ...], known: dict[str, int]) -> int:
    """Number of elements of a message."""
    if name in known:
        return known[name]
    if name in above:
        raise LogError(f'the definition of "{name}" contains itself')
    lines = total = 0
    for field, (kind, detail) in definitions[name][1] if name in definitions else ():
        inner, length = detail if int(kind) > _NAME else ((kind, detail), 1)
        text, message = inner[1][0] == "string" and int(inner[0]) == _BASE, int(inner[0]) == _NAME
        size = _elements(inner[1], definitions, (*above, name), known) if message else 1
        if int(kind) == _ARRAY:
            lines += length if text or message else 1
            total += length * max(size, 1) if text or message else 1
        else:
            lines, total = lines + 1, total + size
        if lines > MOST_LINES or total > MOST_ELEMENTS:
            raise LogError(
                f'the definition of "{name}": field "{field}" makes it larger than {MOST_LINES} fields or '
                f"{MOST_ELEMENTS} elements"
            )
    known[name] = total
    return total

"""Progress messages of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Iterable

Progress = Callable[[str], object]
"""Called with the name of the step that begins."""


def silent(doing: str) -> None:
    """Ignore the message."""


def in_company_of(names: Iterable[str]) -> str:
    """Return " together with A, B" for the accepted causes A and B; an empty text without any."""
    listed = ", ".join(names)
    return f" together with {listed}" if listed else ""

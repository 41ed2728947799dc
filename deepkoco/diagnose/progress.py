"""What a diagnosis is doing at the moment, for those who wait for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

Progress = Callable[[str], object]
"""Called with what begins now, in a few words."""


def silent(doing: str) -> None:
    """Nobody is told."""


def in_company_of(names: Iterable[str]) -> str:
    """Words to go on with: that these are there as well; none where there are none."""
    listed = ", ".join(names)
    return f" beside {listed}" if listed else ""

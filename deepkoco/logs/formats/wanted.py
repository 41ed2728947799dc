"""Which fields of a log file are read."""

from collections.abc import Iterable, Mapping

Wanted = Mapping[str, Iterable[str]] | None
"""Fields to read, by topic; None: all that are not too large."""

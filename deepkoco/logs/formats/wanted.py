"""Selection of the fields to read from a log file."""

from collections.abc import Iterable, Mapping

Wanted = Mapping[str, Iterable[str]] | None
"""Topic -> fields to read; None reads all fields except long lists."""

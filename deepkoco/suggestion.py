"""What a mistyped name was probably meant to be."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(given: str, known: Iterable[str], most: int = 2) -> str:
    """Words for an error message.

    Args:
        given: What the user wrote.
        known: The names there are.
        most: Most names that are proposed.

    Returns:
        "; did you mean X or Y?", or nothing where no name is close.
    """
    by_form = {_plain(name): name for name in known}
    close = difflib.get_close_matches(_plain(given), by_form, n=most, cutoff=0.7)
    return f"; did you mean {' or '.join(by_form[form] for form in close)}?" if close else ""


def _plain(name: str) -> str:
    return name.lstrip("-").lower().replace("-", "_")

"""Causes of a system by the names that a user gives."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from deepkoco.diagnose.causes.cause import Cause, kind_of


class UnknownCauseError(ValueError):
    """A name belongs to no cause of the system."""


def causes_named(known: dict[str, Cause], names: Sequence[str], system: str) -> list[Cause]:
    """Causes by name, each once.

    Args:
        known: Every cause of the system by its name there, as :func:`deepkoco.diagnose.causes.catalogue` gives them.
        names: Names of single causes (``coulomb(joint 2)``), or of a kind, which stands for that cause at every
            joint, command or channel (``coulomb``).
        system: Name of the system, for the error.

    Raises:
        UnknownCauseError: A name is neither; the message lists those known.
    """
    kinds: dict[str, list[Cause]] = {}
    for cause in known.values():
        kinds.setdefault(kind_of(cause.name), []).append(cause)
    found: dict[str, Cause] = {}
    for name in [names] if isinstance(names, str) else names:
        chosen = [known[name]] if name in known else kinds.get(name, [])
        if not chosen:
            close = difflib.get_close_matches(name, [*known, *kinds], n=3, cutoff=0.6)
            said = f"; did you mean {' or '.join(close)}?" if close else ";"
            raise UnknownCauseError(f'{system} has no cause "{name}"{said} it has: {", ".join(known)}')
        found |= {cause.name: cause for cause in chosen}
    return list(found.values())

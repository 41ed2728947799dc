"""Causes of a system by the names that a user gives."""

from __future__ import annotations

from collections.abc import Sequence

from deepkoco.diagnose.causes.cause import Cause, kind_of
from deepkoco.suggestion import did_you_mean


class UnknownCauseError(ValueError):
    """A name belongs to no cause of the system."""


def causes_named(known: dict[str, Cause], names: Sequence[str], system: str) -> list[Cause]:
    """Return the causes with the given names, each once.

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
            said = did_you_mean(name, [*known, *kinds], 3) or ";"
            raise UnknownCauseError(f'{system} has no cause "{name}"{said} it has: {", ".join(known)}')
        found |= {cause.name: cause for cause in chosen}
    return list(found.values())

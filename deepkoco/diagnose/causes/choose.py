"""Causes of a system by the names that a user gives."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from deepkoco.diagnose.causes.cause import Cause, kind_of
from deepkoco.logs.recording import Recording
from deepkoco.suggestion import did_you_mean
from deepkoco.systems.effects import EFFECTS


class UnknownCauseError(ValueError):
    """A name belongs to no cause of the system."""


def measured_channels(recordings: Iterable[Recording]) -> frozenset[str]:
    """Return the names of the channels that at least one of the logs measures."""
    return frozenset(name for recording in recordings for name in recording.names("measurement"))


def shown_causes(known: dict[str, Cause], measured: Collection[str]) -> list[Cause]:
    """Return the causes that logs can show: those of a channel need that channel, and some need others beside it.

    What no log shows would share the prior probability of what they do show, and one hypothesis under two names would
    count twice: the delay of the only channel is that of all measurements.

    Args:
        known: Every cause of the system by its name there, as :func:`deepkoco.diagnose.causes.catalogue` gives them.
        measured: Names of the channels that the logs measure.
    """
    return [c for c in known.values() if _shown(c, measured)]


def _shown(cause: Cause, measured: Collection[str]) -> bool:
    if cause.beside and set(cause.beside).isdisjoint(measured):
        return False
    if cause.among and len(set(cause.among).intersection(measured)) < 2:
        return False
    effect = EFFECTS.get(cause.kind)
    if effect is None or effect.site != "channel":
        return True
    return cause.name.removeprefix(f"{cause.kind}(").removesuffix(")") in measured


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

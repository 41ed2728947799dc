"""Propose a mapping for a named system, or for the system that fits a log best."""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

from deepkoco.logs.inspect.evidence import samples_of
from deepkoco.logs.inspect.proposal import Proposal, Proposer
from deepkoco.logs.inspect.survey import Survey
from deepkoco.systems import System, UnknownSystemError, any_system, make_system, system_names

ALIKE = 1.0  # difference of evidence per channel below which two systems fit equally well [nats]


class NoProposalError(ValueError):
    """No system fits a log."""


class Fitting(NamedTuple):
    """The best proposal, and the names of systems that fit equally well."""

    proposal: Proposal
    alike: tuple[str, ...]


def propose(survey: Survey, system: str | System | None = None) -> Fitting:
    """Propose which columns of a log are which channels.

    Args:
        survey: survey of the log.
        system: the system, or what `load_system` takes; None takes the known system that fits best.

    Raises:
        NoProposalError: No column is a time, or no system gets a command and a measurement.
        UnknownSystemError: There is no such system.
    """
    proposer = Proposer(survey, samples_of(survey))
    systems = [any_system(system)] if system is not None else _known()
    proposals = [proposer.propose(tried) for tried in systems]
    usable = [p for p in proposals if p.complete]
    if not usable:
        if not any(clocks for clocks in survey.clocks.values()):
            raise NoProposalError(
                f"{survey.log.path}: no column is a time; a log needs a column of increasing stamps, "
                "named t, time or stamp"
            )
        missing = [c.channel.name for c in proposals[0].choices if c.column is None]
        what = (
            f"no column fits the channel {', '.join(missing)} of {systems[0].name}"
            if system
            else "no system fits it"
        )
        raise NoProposalError(
            f"{survey.log.path}: {what}: a mapping needs at least a command and a measurement; write the sidecar by "
            'hand, or choose another system ("deepkoco systems" lists them)'
        )
    usable.sort(key=lambda p: -_fit(p))
    best = usable[0]
    alike = tuple(p.system for p in usable[1:] if _fit(best) - _fit(p) < ALIKE)
    return Fitting(best, alike)


def _known() -> list[System]:
    """Every system with a name, without those whose package is broken: another system may be the right one."""
    found = []
    for name in system_names():
        with suppress(UnknownSystemError):
            found.append(make_system(name))
    return found


def _fit(proposal: Proposal) -> float:
    """Evidence per channel, lowered for channels without a column, so that larger systems have no advantage."""
    found = sum(c.column is not None for c in proposal.choices)
    return proposal.score * found / len(proposal.choices) ** 2

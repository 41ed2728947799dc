"""Propose a mapping for a named system, or for the system that fits a log best."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.logs.inspect.evidence import samples_of
from deepkoco.logs.inspect.proposal import Proposal, Proposer
from deepkoco.logs.inspect.survey import Survey
from deepkoco.systems import SYSTEMS, make_system

ALIKE = 1.0  # difference of evidence per channel below which two systems fit equally well [nats]


class NoProposalError(ValueError):
    """No system fits a log."""


class Fitting(NamedTuple):
    """The best proposal, and the names of systems that fit equally well."""

    proposal: Proposal
    alike: tuple[str, ...]


def propose(survey: Survey, system: str | None = None) -> Fitting:
    """Propose which columns of a log are which channels.

    Args:
        survey: survey of the log.
        system: name of the system; None takes the system that fits best.

    Raises:
        NoProposalError: No column is a time, or no system gets a command and a measurement.
        UnknownSystemError: There is no such system.
    """
    proposer = Proposer(survey, samples_of(survey))
    names = [system] if system is not None else list(SYSTEMS)
    proposals = [proposer.propose(make_system(name)) for name in names]
    usable = [p for p in proposals if p.complete]
    if not usable:
        if not any(clocks for clocks in survey.clocks.values()):
            raise NoProposalError(
                f"{survey.log.path}: no column is a time; a log needs a column of increasing stamps, "
                "named t, time or stamp"
            )
        missing = [c.channel.name for c in proposals[0].choices if c.column is None]
        what = (
            f"no column fits the channel {', '.join(missing)} of {system}" if system else "no system fits it"
        )
        raise NoProposalError(
            f"{survey.log.path}: {what}: a mapping needs at least a command and a measurement; write the sidecar by "
            'hand, or choose another system ("deepkoco systems" lists them)'
        )
    usable.sort(key=lambda p: -_fit(p))
    best = usable[0]
    alike = tuple(p.system for p in usable[1:] if _fit(best) - _fit(p) < ALIKE)
    return Fitting(best, alike)


def _fit(proposal: Proposal) -> float:
    """Evidence per channel, lowered for channels without a column, so that larger systems have no advantage."""
    found = sum(c.column is not None for c in proposal.choices)
    return proposal.score * found / len(proposal.choices) ** 2

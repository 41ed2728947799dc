"""Propose a mapping for a named system, or for the system that fits a log best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

from deepkoco.logs.inspect.choice import Proposal
from deepkoco.logs.inspect.counts_of_speed import with_counts_of_speed
from deepkoco.logs.inspect.evidence import samples_of
from deepkoco.logs.inspect.joints import has_named_joints, propose_joints
from deepkoco.logs.inspect.left_over import with_what_is_left
from deepkoco.logs.inspect.lone_units import with_likely_units, with_units_held
from deepkoco.logs.inspect.misfit import misfit
from deepkoco.logs.inspect.other_quantity import with_numbers_of_drives
from deepkoco.logs.inspect.proposal import Proposer
from deepkoco.logs.inspect.survey import Survey
from deepkoco.logs.units import factor_between, parse_unit
from deepkoco.logs.unused import listed
from deepkoco.systems import System, UnknownSystemError, any_system, make_system, system_names

_TURN, _WAY = 2.0 * math.pi, 5e-3  # of the lead in an example [m]
ALIKE = 1.0  # difference of evidence per channel below which two systems fit equally well [nats]


class NoProposalError(ValueError):
    """No system fits a log.

    Attributes:
        found: what was found for the system that the user named, without what a mapping needs; None if nothing.
    """

    def __init__(self, message: str, found: Proposal | None = None) -> None:
        super().__init__(message)
        self.found = found


class Fitting(NamedTuple):
    """The best proposal.

    Attributes:
        proposal: the proposal.
        alike: names of systems that fit equally well.
        doubt: reason why the system cannot have made the log; None if there is none.
        idle: names of commands without a column that drive joints of which the log shows the position.
    """

    proposal: Proposal
    alike: tuple[str, ...]
    doubt: str | None = None
    idle: tuple[str, ...] = ()


def propose(survey: Survey, system: str | System | None = None, others: Sequence[Survey] = ()) -> Fitting:
    """Propose which columns of a log are which channels.

    Args:
        survey: survey of the log.
        system: the system, or what `load_system` takes; None takes the known system that fits best.
        others: further logs with the same columns, as evidence of directions and zeros.

    Raises:
        NoProposalError: No column is a time, no system gets a command and a measurement, or none fits the log.
        UnknownSystemError: There is no such system.
    """
    if not any(survey.clocks.values()):
        raise _without_time(survey)
    samples = samples_of(survey)
    proposer: Proposer | None = None
    systems = _known() if system is None else [any_system(system)]
    proposals: dict[str, tuple[System, Proposal]] = {}
    for found in systems:
        if has_named_joints(found):
            proposals[found.name] = found, propose_joints([survey, *others], found)
            continue
        proposer = proposer or Proposer(survey, samples)
        proposal = proposer.propose(found)
        if system is not None:
            # The log of a system that the user names holds most of its channels, and follows its equations. Known
            # systems compete by the evidence of the log alone.
            proposal = with_counts_of_speed(found, with_what_is_left(survey, proposal), samples)
            proposal = with_likely_units(found, proposal, samples)
        proposals[found.name] = found, proposal
    proposals = {n: (own, with_numbers_of_drives(own, found)) for n, (own, found) in proposals.items()}
    if system is not None:
        proposals = {n: (own, with_units_held(own, found, samples)) for n, (own, found) in proposals.items()}
    usable = [name for name, (_, proposal) in proposals.items() if proposal.complete(survey)]
    if not usable:
        raise _nothing(survey, next(iter(proposals.values()))[1], system is not None)
    doubts = {name: misfit(*proposals[name], survey, samples) for name in usable}
    fitting = usable if system is not None else [name for name in usable if doubts[name] is None]
    if not fitting:
        nearest = max(usable, key=lambda name: _fit(proposals[name][1]))
        raise NoProposalError(
            f"{survey.log.path}: none of the known systems fits this log; the nearest, {nearest}, does not because "
            f"{doubts[nearest]}; give your own with --system my_robot.py:CLASS, arm.xml or arm.urdf"
        )
    fitting.sort(key=lambda name: -_fit(proposals[name][1]))
    best = proposals[fitting[0]][1]
    alike = tuple(name for name in fitting[1:] if _fit(best) - _fit(proposals[name][1]) < ALIKE)
    return Fitting(best, alike, doubts[fitting[0]], _idle_drives(*proposals[fitting[0]]))


def _idle_drives(system: System, proposal: Proposal) -> tuple[str, ...]:
    """Commands without a column, although the log shows the position of the joint that they drive.

    Where the log lacks the joint, too, the joint can be held.
    """
    if not has_named_joints(system):
        return ()
    shown = {c.channel.name for c in proposal.choices if c.column is not None}
    lacking = {c.channel.name for c in proposal.choices if c.column is None and c.channel.default is None}
    driven = zip(system.commands, system.command_joints, strict=False)
    return tuple(c.name for c, j in driven if c.name in lacking and f"q_{system.joint_names[j]}" in shown)


def _without_time(survey: Survey) -> NoProposalError:
    return NoProposalError(
        f"{survey.log.path}: no column is a time; a log needs a column of increasing stamps, named t, time or stamp"
    )


def _nothing(survey: Survey, proposal: Proposal, asked: bool) -> NoProposalError:
    """Error if no proposal has a command and a measurement."""
    missing = [c.channel.name for c in proposal.choices if c.column is None and c.channel.default is None]
    commands = [c for c in proposal.choices if c.channel.kind == "command"]
    measured = any(c.column is not None for c in proposal.choices if c.channel.kind == "measurement")
    if asked and measured and all(c.channel.default is not None and c.column is None for c in commands):
        names = ", ".join(c.channel.name for c in commands)
        return NoProposalError(
            f"{survey.log.path}: no column fits a command of {proposal.system} ({names}), and "
            f"{listed(proposal.unused(survey))} may be one; write the sidecar by hand: with it as command if it drives "
            "a joint, without a command if the log shows a free motion",
            proposal,
        )
    what = (
        f"no column fits the channel {', '.join(missing)} of {proposal.system}"
        if asked
        else "no system fits it"
    )
    return NoProposalError(
        f"{survey.log.path}: {what}: a mapping needs at least a command and a measurement; "
        f"{_behind_a_screw(survey, proposal)}write the sidecar by hand, or choose another system "
        '("deepkoco systems" lists them)',
        proposal if asked else None,
    )


def _behind_a_screw(survey: Survey, proposal: Proposal) -> str:
    """How to map the angle of a motor that moves a slide; empty where there is no such pair."""
    lengths = [
        c.channel for c in proposal.choices if c.column is None and _quantity(c.channel.unit) == "length"
    ]
    taken = {c.column.label for c in proposal.choices if c.column is not None}
    angles = [
        c
        for c in survey.columns
        if c.kind == "number" and c.label not in taken and _quantity(c.hints.unit or "1") == "angle"
    ]
    if len(lengths) != 1 or len(angles) != 1:
        return ""
    (channel,), (column,) = lengths, angles
    unit = column.hints.unit
    assert unit is not None  # what has none is of no quantity
    example = _WAY * factor_between(unit, "rad") / _TURN
    return (
        f'"{column.name}" is an angle, and {channel.name} is a length: where a screw or a drum is between the two, map '
        f"it with unit: {channel.unit} and as scale the way of one {unit} (5 mm a turn: {example:.6g}); "
    )


def _quantity(unit: str) -> str:
    return parse_unit(unit).quantity


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

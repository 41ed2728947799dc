"""The mapping of a log without a sidecar, where its names and values leave no doubt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from deepkoco.logs.formats.log_file import LogError
from deepkoco.logs.formats.open_log import open_log
from deepkoco.logs.inspect.choice import Proposal, mapping_of
from deepkoco.logs.inspect.fitting import Fitting, NoProposalError, propose
from deepkoco.logs.inspect.survey import Survey, survey_log
from deepkoco.logs.part import split_part
from deepkoco.logs.runs import split_run
from deepkoco.logs.sidecar import dump_sidecar
from deepkoco.systems import System

MOST_LOGS = 40  # further logs with the same columns that are compared


def sure_mapping(log: Path, others: Sequence[Path], system: System) -> tuple[dict[str, Any], str]:
    """Content of a sidecar, and a sentence that says what was taken and assumed.

    Args:
        log: The log; a part or a run of it counts as the whole.
        others: Further logs without a sidecar; those with the same columns serve as evidence.
        system: The system.

    Raises:
        LogError: The mapping is not sure; the message says why.
    """
    survey, further = _survey(log), []
    for path in others[:MOST_LOGS]:
        if split_run(split_part(path)[0])[0] != split_run(split_part(log)[0])[0]:
            other = _survey(path)
            if [c.label for c in other.columns] == [c.label for c in survey.columns]:
                further.append(other)
    try:
        fitting = propose(survey, system, further)
    except NoProposalError as error:
        raise LogError(str(error)) from error
    doubt = _doubt(fitting)
    if doubt is not None:
        raise LogError(doubt)
    text = dump_sidecar(None, mapping_of(survey, fitting.proposal), {"proposed by": "deepkoco inspect"})
    return yaml.safe_load(text), _said(fitting.proposal)


def _survey(log: Path) -> Survey:
    whole, run = split_run(split_part(log)[0])
    return survey_log(open_log(whole), run or 0)


def _doubt(fitting: Fitting) -> str | None:
    """Why a proposal is not sure; None where it is."""
    for choice in fitting.proposal.choices:
        name, column = choice.channel.name, choice.column
        if column is None and choice.channel.kind == "command" and choice.channel.default is None:
            return f"no column is the command {name} for sure"
        if column is not None and choice.sureness != "sure":
            rival = "" if choice.rival is None else f", or {choice.rival}"
            return f"{name} is {choice.sureness}: {column.label}{rival}"
        if column is not None and not choice.stated and choice.unit != choice.channel.unit:
            return f"no name says that {column.label} is in {choice.unit}"
    return fitting.doubt


def _said(proposal: Proposal) -> str:
    taken = ", ".join(
        f"{c.channel.name} = {c.column.label} [{c.unit}]" for c in proposal.choices if c.column is not None
    )
    unknown = {
        what: [joint.model for joint in proposal.joints if not getattr(joint, f"{what}_known")]
        for what in ("sign", "zero")
    }
    words = {"sign": "direction", "zero": "zero"}
    assumed = "; ".join(f"the {words[k]} of {', '.join(v)} is the model's" for k, v in unknown.items() if v)
    return (
        f"no sidecar: {taken}"
        + (f"; assumed: {assumed}" if assumed else "")
        + "; to correct it, write it with "
        "deepkoco inspect --out"
    )

"""Convert an inspection to plain JSON types."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from deepkoco.logs.inspect.doubts import doubts_of
from deepkoco.logs.inspect.fitting import Fitting
from deepkoco.logs.inspect.log_summary import summarise
from deepkoco.logs.inspect.survey import Survey
from deepkoco.logs.recording import Recording


def content(
    survey: Survey, fitting: Fitting | None, recording: Recording | None, problem: str | None
) -> dict[str, Any]:
    """Content of `deepkoco inspect --json`; keys are only ever added."""
    proposal = None if fitting is None else fitting.proposal
    result: dict[str, Any] = {
        "path": str(survey.log.path),
        "format": survey.log.form,
        "system": None if recording is None else recording.system,
        "channels": [] if recording is None else [asdict(summary) for summary in summarise(recording)],
        "meta": {} if recording is None else recording.meta,
        "clocks": [asdict(clock) for clocks in survey.clocks.values() for clock in clocks],
        "columns": [asdict(column) for column in survey.columns],
        "runs": survey.runs,
        "proposal": None if fitting is None else _proposal(fitting),
        "warnings": list(recording.warnings) if recording is not None else doubts_of(survey, proposal),
        "problem": problem,
    }
    return _plain(result)


def _proposal(fitting: Fitting) -> dict[str, Any]:
    proposal = fitting.proposal
    channels = {}
    for choice in proposal.choices:
        column = choice.column
        channels[choice.channel.name] = {
            "topic": None if column is None else column.topic,
            "column": None if column is None else column.name,
            "unit": choice.unit,
            "unit_stated": choice.stated,
            "kind": choice.channel.kind,
            "sureness": choice.sureness,
            "probability": choice.probability,
            "reasons": list(choice.reasons),
            "rival": choice.rival,
            "scale": choice.scale,
            "offset": choice.offset,
        }
    return {
        "system": proposal.system,
        "alike": list(fitting.alike),
        "time_unit": proposal.time,
        "score": proposal.score,
        "doubt": fitting.doubt,
        "joints": [joint.to_json() for joint in proposal.joints],
        "channels": channels,
    }


def _plain(value: Any) -> Any:
    """Convert keys to text, and NaN and infinity to None, which JSON does not have."""
    if isinstance(value, dict):
        return {str(key): _plain(member) for key, member in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(member) for member in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

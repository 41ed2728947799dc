"""Looking into a log before it is used: what is in it, what it may mean, what is doubtful."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepkoco.logs.inspect.doubts import doubts_of
    from deepkoco.logs.inspect.fitting import Fitting, NoProposalError, propose
    from deepkoco.logs.inspect.proposal import Choice, Proposal, Proposer, mapping_of
    from deepkoco.logs.inspect.survey import ColumnSurvey, Survey, survey_log

# Imported when they are asked for, so that the help of the command needs nothing heavy.
_LATER = {
    "doubts_of": "doubts",
    **dict.fromkeys(("Fitting", "NoProposalError", "propose"), "fitting"),
    **dict.fromkeys(("Choice", "Proposal", "Proposer", "mapping_of"), "proposal"),
    **dict.fromkeys(("ColumnSurvey", "Survey", "survey_log"), "survey"),
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)


__all__ = [
    "Choice",
    "ColumnSurvey",
    "Fitting",
    "NoProposalError",
    "Proposal",
    "Proposer",
    "Survey",
    "doubts_of",
    "mapping_of",
    "propose",
    "survey_log",
]

"""Inspect a log: its contents, a proposed mapping, and possible mistakes."""

from deepkoco.logs.inspect.choice import Choice, Proposal, mapping_of
from deepkoco.logs.inspect.doubts import doubts_of
from deepkoco.logs.inspect.fitting import Fitting, NoProposalError, propose
from deepkoco.logs.inspect.proposal import Proposer
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey, survey_log

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

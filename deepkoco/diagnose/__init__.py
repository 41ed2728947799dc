"""Diagnosis of a simulation from logs of the unit: name the cause of the difference and measure the gain."""

from deepkoco.callable_package import make_callable
from deepkoco.diagnose.baseline import BaselineError
from deepkoco.diagnose.causes import CAUSES, Cause, UnknownCauseError
from deepkoco.diagnose.diagnose import diagnose
from deepkoco.diagnose.diagnosis import Diagnosis, Estimate, Evidence, Finding
from deepkoco.diagnose.report.folder import write_report
from deepkoco.output.new_folder import FolderExistsError

__all__ = [
    "CAUSES",
    "BaselineError",
    "Cause",
    "Diagnosis",
    "Estimate",
    "Evidence",
    "Finding",
    "FolderExistsError",
    "UnknownCauseError",
    "diagnose",
    "write_report",
]

make_callable(__name__)

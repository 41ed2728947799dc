"""Show what a simulation gets wrong about a unit, name the cause, and measure what it is worth."""

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

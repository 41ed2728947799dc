"""Show what a simulation gets wrong about a unit, name the cause, and measure what it is worth."""

from deepkoco.diagnose.causes import CAUSES, Cause
from deepkoco.diagnose.diagnose import diagnose
from deepkoco.diagnose.diagnosis import Diagnosis, Estimate, Evidence, Finding
from deepkoco.diagnose.report import OutputExistsError, write_report

__all__ = [
    "CAUSES",
    "Cause",
    "Diagnosis",
    "Estimate",
    "Evidence",
    "Finding",
    "OutputExistsError",
    "diagnose",
    "write_report",
]

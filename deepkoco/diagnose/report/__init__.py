"""A diagnosis as a folder: page, text, figures and the extended model."""

from deepkoco.diagnose.report.folder import write_report

__all__ = ["write_report"]

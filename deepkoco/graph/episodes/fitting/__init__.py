"""Delay models fitted from recordings."""

from deepkoco.graph.episodes.fitting.model import DelayModel, FitError, fit_delays
from deepkoco.graph.episodes.fitting.stall_detection import FoundStall, find_stalls

__all__ = ["DelayModel", "FitError", "FoundStall", "find_stalls", "fit_delays"]

"""Nodes, delays, timing and execution of robot simulations, and recordings of what happened."""

from deepkoco.graph.recording import LogError, Recording, Series, read_log, write_log

__all__ = ["LogError", "Recording", "Series", "read_log", "write_log"]

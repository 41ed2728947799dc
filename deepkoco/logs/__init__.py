"""Logs of real or simulated units: read, checked and inspected."""

from deepkoco.logs.recording import LogError, Recording, Series, read_log, write_log

__all__ = ["LogError", "Recording", "Series", "read_log", "write_log"]

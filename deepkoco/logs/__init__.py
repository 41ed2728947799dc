"""Read, check and inspect logs of real or simulated units."""

from deepkoco.logs.read_logs import read_logs
from deepkoco.logs.recording import LogError, Recording, Series, read_log, write_log

__all__ = ["LogError", "Recording", "Series", "read_log", "read_logs", "write_log"]

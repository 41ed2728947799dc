"""Time that a training took, over all its resumptions."""

from __future__ import annotations

import time
from typing import Protocol


class Timed(Protocol):
    """What keeps the time spent in a checkpoint.

    Attributes:
        seconds: Of the wall clock [s].
        processor_seconds: Of processors, all threads of the process together [s].
    """

    seconds: float
    processor_seconds: float


class Stopwatch:
    """Goes on from the time that a progress has noted.

    Args:
        progress: Of the run, as it begins or is resumed.
    """

    def __init__(self, progress: Timed) -> None:
        self._wall = time.perf_counter() - progress.seconds
        self._processor = time.process_time() - progress.processor_seconds

    def row(self) -> dict[str, float]:
        """Metrics ``seconds`` and ``processor_seconds``; the second is the fairer where others use the machine too."""
        return {
            "seconds": time.perf_counter() - self._wall,
            "processor_seconds": time.process_time() - self._processor,
        }

    def note(self, progress: Timed) -> None:
        """Write the time so far into the progress, for the checkpoint."""
        spent = self.row()
        progress.seconds, progress.processor_seconds = spent["seconds"], spent["processor_seconds"]

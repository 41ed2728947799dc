"""Where a training run stands."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Progress:
    """Where a run stands.

    Attributes:
        iteration: Finished iterations.
        collected: Whether the present iteration's episodes are in the buffer.
        iteration_updates: Updates done in the present iteration.
        updates: Updates done in all.
        seconds: Time spent, over all resumptions [s].
        processor_seconds: The same of processors; runs of earlier releases begin to count when they are resumed [s].
    """

    iteration: int = 0
    collected: bool = False
    iteration_updates: int = 0
    updates: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0

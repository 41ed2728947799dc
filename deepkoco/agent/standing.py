"""How far a training run is, as told to whoever draws its progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from deepkoco.agent.metrics import Row


@dataclass(frozen=True)
class Standing:
    """Where a run stands.

    Attributes:
        completed, total: Of what the run does now, such as the updates of its present iteration.
        text: What it does now, a few words.
        row: The row of metrics that was just added; None between two rows.
        note: What the run has just decided, a sentence; empty for nothing.
    """

    completed: int
    total: int
    text: str
    row: Row | None = None
    note: str = ""


Report = Callable[[Standing], None]
"""Called now and then while a run trains."""

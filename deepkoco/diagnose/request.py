"""What a diagnosis is asked: the logs to explain, the system as given, and how to search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.data import Data
from deepkoco.diagnose.progress import Progress
from deepkoco.diagnose.time_limit import TimeLimit
from deepkoco.logs.recording import Recording
from deepkoco.systems import System


@dataclass(frozen=True)
class DiagnosisRequest:
    """Input of every stage of a diagnosis; no stage changes it.

    Attributes:
        recordings: Logs to explain.
        system: The system as given.
        data: Windows of the logs.
        length: Length of a window [s].
        seed: Seed of the bootstrap.
        detection: Fall of the BIC from which a cause is named.
        causes: Causes to try.
        progress: Called with the name of each step.
        began: When the diagnosis began, by ``time.perf_counter`` [s].
        evidence: Whether the method of probabilities answers too.
        limit: Asked before every step that an answer can do without; it remembers those that it refused.
        holdout: Logs that are never fitted.
        usual: Length [s] that the windows have where the simulation as given follows the logs; no window is longer.
        regrouping: Causes to try only in the place of many parameters that a refit moved.
    """

    recordings: Sequence[Recording]
    system: System
    data: Data
    length: float
    seed: int
    detection: float
    causes: Sequence[Cause]
    progress: Progress
    began: float
    evidence: bool = False
    limit: TimeLimit = field(default_factory=TimeLimit)
    holdout: Sequence[Recording] = ()
    usual: float = 0.0
    regrouping: Sequence[Cause] = ()

"""How the nodes at a robot run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from deepkoco.graph.live.crew_plan import Factory
from deepkoco.graph.net.link import SILENCE


@dataclass(frozen=True)
class RobotOptions:
    """How the nodes at the robot run.

    Attributes:
        threads, factories, pin, priority, time_limit, beat_limit: as for `WallClockRuntime`.
        silence: longest time [s] without anything from the end that leads, and beyond its period from one message to a
            node here to the next. After it all nodes are closed, which leaves hardware safe.
        record: folder for the recordings, one file for each session; None: none are kept here.
    """

    threads: Sequence[str] = ()
    factories: Mapping[str, Factory] = field(default_factory=dict)
    pin: bool = True
    priority: int | None = None
    time_limit: float = 1.0
    beat_limit: float = 1.0
    silence: float = SILENCE
    record: str | Path | None = None

"""What an engine is: it supplies the nodes of an object, simulated or real."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from deepkoco.graph import Node
from deepkoco.systems import JointSystem


class EngineError(ValueError):
    """An engine, an object or one of its settings is not known, or cannot do what is asked."""


@dataclass(frozen=True)
class Engine(ABC):
    """Supplies the nodes ``world`` and ``sensor`` of an object; the rest of the graph knows no engine.

    ``world`` takes commands (1,) from the input ``agent`` and puts out the state, or what is known of it, (S,);
    ``sensor`` takes the input ``world`` and puts out the measurements (N,). Both take the parameter ``start``
    (1, S) or (B, S), the start state of the episode, besides the system's.

    Attributes:
        world_rate: Ticks of ``world`` per second [Hz].
        sensor_rate: Measurements per second [Hz]; None: the world's.
        command_limit: Largest command, in the command's unit; the object's own limit holds besides.
    """

    world_rate: float = 100.0
    sensor_rate: float | None = None
    command_limit: float = math.inf

    name: ClassVar[str]
    real_time: ClassVar[bool] = False
    """Whether it runs by the clock on the wall."""

    @abstractmethod
    def nodes(self, system: JointSystem) -> tuple[Node, Node]:
        """The nodes ``world`` and ``sensor`` of an object with these dynamics.

        Raises:
            EngineError: The engine cannot run this object.
        """

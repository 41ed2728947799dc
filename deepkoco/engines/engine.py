"""What an engine is: it supplies the nodes of an object, simulated or real."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

from deepkoco.graph import Node
from deepkoco.systems import Channel, System


class EngineError(ValueError):
    """An engine, an object or one of its settings is not known, or cannot do what is asked."""


class EngineObject(Protocol):
    """What a graph is about: a machine or a thing with named actuators and sensors, whatever engine runs it."""

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """What takes commands."""
        ...

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """What is measured."""
        ...

    @property
    def dynamics(self) -> Any:
        """Its nominal equations of motion, a `System`."""
        ...


class Ports(NamedTuple):
    """Where an object is connected.

    Attributes:
        world: Node that simulates it.
        command: Input of this node for its commands; None: it has no actuators.
        sensor: Node that measures it; empty: nothing is measured.
    """

    world: str
    command: str | None
    sensor: str


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

    def build(self, objects: Mapping[str, EngineObject]) -> tuple[list[Node], dict[str, Ports]]:
        """The nodes of several objects and where each object is connected.

        Args:
            objects: By name; the name of a single one is empty, and its nodes are ``world`` and ``sensor``. Those of a
                named object are ``NAME_world`` and ``NAME_sensor``.

        Raises:
            EngineError: The engine cannot run an object.
        """
        nodes: list[Node] = []
        ports = {}
        for name, each in objects.items():
            world, sensor = self.nodes(each.dynamics)
            if name:
                world.name, sensor.name = f"{name}_world", f"{name}_sensor"
            nodes += [world, sensor]
            ports[name] = Ports(world.name, "agent", sensor.name)
        return nodes, ports

    @abstractmethod
    def nodes(self, system: System) -> tuple[Node, Node]:
        """The nodes ``world`` and ``sensor`` of an object with these dynamics.

        Raises:
            EngineError: The engine cannot run this object.
        """

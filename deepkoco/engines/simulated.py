"""Engines that simulate: the system's own equations, and MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from deepkoco.engines.engine import Engine, EngineError
from deepkoco.engines.mujoco_world import MujocoWorld, import_mujoco
from deepkoco.engines.ode import World
from deepkoco.engines.robot import OBJECTS
from deepkoco.engines.sensor import Sensor
from deepkoco.graph import Node
from deepkoco.systems import ExtendedSystem, JointSystem


@dataclass(frozen=True)
class OdeEngine(Engine):
    """The system's equations, integrated in the graph: pure nodes, any runtime, thousands at once.

    Attributes:
        integrator: ``rk4`` or ``semi_implicit_euler``.
        speed_limit: The joint goes no faster [rad/s].
        noise: Whether measurements carry the noise that the system's channels declare.
    """

    integrator: str = "rk4"
    speed_limit: float = math.inf
    noise: bool = False
    name: ClassVar[str] = "ode"

    def nodes(self, system: JointSystem) -> tuple[Node, Node]:
        world = World(system, self.world_rate, self.integrator, self.command_limit, self.speed_limit)
        return world, Sensor(system, self.sensor_rate or self.world_rate, _noise(system, self.noise))


@dataclass(frozen=True)
class MujocoEngine(Engine):
    """MuJoCo on a model with the same dynamics as the system; one environment, the ``simulated`` runtime.

    Attributes:
        time_step: Longest step of the physics [s].
        speed_limit: The joint goes no faster [rad/s].
        noise: Whether measurements carry the noise that the system's channels declare.
    """

    time_step: float = 1e-3
    speed_limit: float = math.inf
    noise: bool = False
    name: ClassVar[str] = "mujoco"

    def nodes(self, system: JointSystem) -> tuple[Node, Node]:
        if isinstance(system, ExtendedSystem) and system.effects:
            raise EngineError(
                f"mujoco: its model of {system.name} has no effects; use the ode engine for an extended system"
            )
        if system.name not in OBJECTS:
            raise EngineError(f"mujoco: no model of {system.name}; there are {', '.join(OBJECTS)}")
        import_mujoco()  # what is missing is told before anything runs
        world = MujocoWorld(
            system,
            OBJECTS[system.name].body,
            self.world_rate,
            self.time_step,
            self.command_limit,
            self.speed_limit,
        )
        return world, Sensor(system, self.sensor_rate or self.world_rate, _noise(system, self.noise))


def _noise(system: JointSystem, noisy: bool) -> tuple[float, ...]:
    return tuple(channel.noise_sd if noisy else 0.0 for channel in system.measurements)

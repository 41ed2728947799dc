"""Engines that simulate: the system's own equations, and MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from deepkoco.engines.engine import Engine, EngineError, EngineObject, Ports
from deepkoco.engines.mjcf_object import MjcfObject
from deepkoco.engines.mjcf_world import MjcfSensor, MjcfWorld
from deepkoco.engines.mujoco_world import MujocoWorld, import_mujoco
from deepkoco.engines.ode import World
from deepkoco.engines.robot import OBJECTS, RobotObject
from deepkoco.engines.scene import Scene
from deepkoco.engines.sensor import Sensor
from deepkoco.graph import Node
from deepkoco.systems import ExtendedSystem, JointSystem, System


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

    def nodes(self, system: System) -> tuple[Node, Node]:
        world = World(system, self.world_rate, self.integrator, self.command_limit, self.speed_limit)
        return world, Sensor(system, self.sensor_rate or self.world_rate, _noise(system, self.noise))


@dataclass(frozen=True)
class MujocoEngine(Engine):
    """MuJoCo: MJCF objects in any number of environments, together in one scene; or the built-in pendulums.

    A pendulum has a model with the same dynamics as its system, and runs in one environment and the ``simulated``
    runtime.

    Attributes:
        time_step: Longest step of the physics of a pendulum [s]; an MJCF object has its own.
        speed_limit: The joint of a pendulum goes no faster [rad/s].
        noise: Whether measurements carry the noise that the channels declare.
        threads: Of the physics of MJCF objects; 0: the caller's thread.
    """

    time_step: float = 1e-3
    speed_limit: float = math.inf
    noise: bool = False
    threads: int = 0
    name: ClassVar[str] = "mujoco"

    def build(self, objects: Mapping[str, EngineObject]) -> tuple[list[Node], dict[str, Ports]]:
        """The nodes of several objects; MJCF objects share the node ``world`` and can touch each other."""
        own = {name: each for name, each in objects.items() if isinstance(each, MjcfObject)}
        nodes, ports = super().build({name: each for name, each in objects.items() if name not in own})
        if not own:
            return nodes, ports
        if math.isfinite(self.speed_limit):
            raise EngineError(
                "mujoco: speed_limit is for pendulums; give the joints of an MJCF object damping instead"
            )
        scene = Scene(own)
        world = MjcfWorld(scene, self.world_rate, self.threads, self.command_limit)
        nodes.append(world)
        for name in own:
            sensor = f"{name}_sensor" if name else "sensor"
            if scene.measurements[name]:
                nodes.append(MjcfSensor(scene, name, self.sensor_rate or self.world_rate, self.noise, sensor))
            command = (name or "agent") if scene.controls[name] else None
            ports[name] = Ports(world.name, command, sensor if scene.measurements[name] else "")
        return nodes, ports

    def nodes(self, system: System) -> tuple[Node, Node]:
        if isinstance(system, ExtendedSystem) and system.effects:
            raise EngineError(
                f"mujoco: its model of {system.name} has no effects; use the ode engine for an extended system"
            )
        known = OBJECTS.get(system.name)
        if not isinstance(known, RobotObject) or not isinstance(system, JointSystem):
            raise EngineError(
                f"mujoco: no model of {system.name}; there are {', '.join(OBJECTS)}, and any MJCF or URDF file"
            )
        import_mujoco()  # what is missing is told before anything runs
        world = MujocoWorld(
            system,
            known.body,
            self.world_rate,
            self.time_step,
            self.command_limit,
            self.speed_limit,
        )
        return world, Sensor(system, self.sensor_rate or self.world_rate, _noise(system, self.noise))


def _noise(system: System, noisy: bool) -> tuple[float, ...]:
    return tuple(channel.noise_sd if noisy else 0.0 for channel in system.measurements)

"""One graph for an object, whatever engine runs it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch

from deepkoco.engines.engine import Engine, EngineError
from deepkoco.engines.robot import find_object
from deepkoco.engines.simulated import MujocoEngine, OdeEngine
from deepkoco.engines.unit import UnitEngine
from deepkoco.graph import Connection, Delay, Graph, Supervisor, make_delay

HOP = 2e-3  # what a message is expected to take between processes [s]
ENGINES: dict[str, type[Engine]] = {engine.name: engine for engine in (OdeEngine, MujocoEngine, UnitEngine)}


def make_graph(
    object: str = "rod_pendulum",
    engine: str | Engine = "ode",
    *,
    agent: Supervisor | None = None,
    control_rate: float = 20.0,
    actuation_delay: Delay | float | Mapping[str, Any] = 0.0,
    sensing_delay: Delay | float | Mapping[str, Any] = 0.0,
) -> Graph:
    """Build the graph of an object and its agent; only the engine's nodes differ between engines.

    The agent's commands go to ``world``, the state at its ticks goes to ``sensor`` and as ``truth`` to the
    agent (on a unit, where nobody knows it, the last measurement), the measurements to the agent.

    Args:
        object: Name of the object.
        engine: ``ode``, ``mujoco``, ``unit``, or one with settings of its own.
        agent: The supervisor; None: one that takes actions and reads nothing.
        control_rate: Its rate, where none is given [Hz].
        actuation_delay: From the agent to the world [s]. A unit's own delays come on top.
        sensing_delay: From the sensor to the agent [s], likewise. In real time, where messages take what they
            take, delays only say when the agent looks first: not before it can have been sent a measurement.

    Raises:
        EngineError: The object or the engine is not known, or they do not go together.
    """
    robot, maker = find_object(object), find_engine(engine)
    if agent is None:
        agent = Supervisor("agent", control_rate, initial_action=torch.zeros(1, dtype=torch.float64))
    world, sensor = maker.nodes(robot.dynamics)
    actuation, sensing, rate = make_delay(actuation_delay), make_delay(sensing_delay), float(agent.rate)
    hop = make_delay(HOP if maker.real_time else 0.0)
    connections = [
        Connection("world", "sensor", delay=hop),
        Connection("world", agent.name, delay=hop, name="truth"),
        Connection("sensor", agent.name, delay=max(sensing, hop, key=lambda law: law.mean)),
        Connection(
            agent.name,
            "world",
            delay=actuation,
            window=command_window(actuation, rate, maker.world_rate),
            skip=True,
            name="agent",
        ),
    ]
    return Graph([world, sensor, agent], connections, supervisor=agent.name)


def find_engine(engine: str | Engine) -> Engine:
    """Look up an engine by name; one with settings is handed back.

    Raises:
        EngineError: There is none; the message lists them.
    """
    if isinstance(engine, Engine):
        return engine
    if engine not in ENGINES:
        raise EngineError(f'no engine "{engine}"; known: {", ".join(ENGINES)}')
    return ENGINES[engine]()


def command_window(delay: Delay, rate: float, world_rate: float) -> int:
    """How many commands a tick of the world must see.

    Those under way may all arrive within one tick, and the one before them still holds; with a constant delay
    they keep their distance.
    """
    spread = 0.0 if delay.constant else delay.highest
    return 2 + math.ceil((spread + 1.0 / world_rate) * rate)

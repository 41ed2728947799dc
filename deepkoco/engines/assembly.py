"""One graph for one or several objects, whatever engine runs them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from deepkoco.engines.engine import Engine, EngineError, EngineObject, Ports
from deepkoco.engines.mjcf_world import MjcfWorld
from deepkoco.engines.robot import find_object
from deepkoco.engines.simulated import MujocoEngine, OdeEngine
from deepkoco.engines.unit import UnitEngine
from deepkoco.graph import Connection, Delay, Graph, Node, Supervisor, make_delay
from deepkoco.graph.model.connection import wide_enough
from deepkoco.systems import System

HOP = 2e-3  # what a message is expected to take between processes [s]
ENGINES: dict[str, type[Engine]] = {engine.name: engine for engine in (OdeEngine, MujocoEngine, UnitEngine)}
Named = str | Path | System | EngineObject


def make_graph(
    object: Named | Mapping[str, Named] = "rod_pendulum",
    engine: str | Engine = "ode",
    *,
    agent: Supervisor | None = None,
    control_rate: float = 20.0,
    actuation_delay: Any = 0.0,
    sensing_delay: Any = 0.0,
    action_nodes: Iterable[Node] | Mapping[str, Iterable[Node]] = (),
    action_entries: Mapping[str, Sequence[int]] | None = None,
) -> Graph:
    """Build the graph of one or several objects and their agent; only the engine's nodes differ between engines.

    The agent's commands go to ``world``, the state at its ticks goes to ``sensor`` and as ``truth`` to the
    agent (on a unit, where nobody knows it, the last measurement), the measurements to the agent.

    Of several objects, each has a sensor ``NAME_sensor`` of its own, and takes its own entries of the action. MJCF
    objects on the engine ``mujoco`` share one ``world`` and can touch each other; any other object has a
    ``NAME_world``. The agent sees each of these under its own name.

    Args:
        object: What `find_object` takes; or several of these by name.
        engine: ``ode``, ``mujoco``, ``unit``, or one with settings of its own.
        agent: The supervisor; None: one that takes actions and reads nothing.
        control_rate: Its rate, where none is given [Hz].
        actuation_delay: From the agent, or the last action node, to the world [s]. A unit's own delays come on top. Of
            several objects, one for all or by name.
        sensing_delay: From the sensor to the agent [s], likewise. In real time, where messages take what they
            take, delays only say when the agent looks first: not before it can have been sent a measurement.
        action_nodes: Nodes between the agent and the actuators, in this order: inverse kinematics, a filter that keeps
            commands safe. Each takes the input ``agent``, what the one before it puts out, and puts out a command; it
            may take ``sensor`` and ``truth`` of its object, too. Of several objects, by name.
        action_entries: By object without action nodes, which entries of the action it takes. None: the objects take
            as many as they have actuators, one after the other.

    Raises:
        EngineError: The object or the engine is not known, or they do not go together.
    """
    maker = find_engine(engine)
    if isinstance(object, Mapping):
        objects = {str(name): find_object(each) for name, each in object.items()}
        for name in objects:
            if not name.isidentifier():
                raise EngineError(f'object "{name}": give it a name of letters, digits and _')
    else:
        objects = {"": find_object(object)}
    several = "" not in objects
    if agent is None:
        width = sum(len(each.actuators) for each in objects.values())
        agent = Supervisor("agent", control_rate, initial_action=torch.zeros(width, dtype=torch.float64))
    nodes, ports = maker.build(objects)
    chains = _by_object("action_nodes", action_nodes, objects, several)
    entries = _entries(objects, chains, action_entries) if several else {}
    hop = make_delay(HOP if maker.real_time else 0.0)
    connections: list[Connection] = []
    for world in dict.fromkeys(port.world for port in ports.values()):
        seen = world if several else "truth"
        connections += _for_agent(agent, Connection(world, agent.name, delay=hop, name=seen))
    graph_nodes = {node.name: node for node in nodes}
    for name, port in ports.items():
        sensing = make_delay(_of(sensing_delay, name, objects))
        if port.sensor:
            name_of_world = None if port.world == "world" else "world"
            seen = Connection(port.world, port.sensor, delay=hop, name=name_of_world)
            connections.append(wide_enough(seen, graph_nodes[port.world], graph_nodes[port.sensor]))
            delay = max(sensing, hop, key=lambda law: law.mean)
            connections += _for_agent(agent, Connection(port.sensor, agent.name, delay=delay))
        if port.command is not None:
            actuation = make_delay(_of(actuation_delay, name, objects))
            connections += _to_world(agent, chains[name], port, hop, actuation, graph_nodes[port.world])
    for name, own in entries.items():
        world: Any = graph_nodes[ports[name].world]
        if isinstance(world, MjcfWorld):
            world.entries[name] = own
        else:
            world.entries = own
    return Graph(
        [*nodes, agent, *(node for chain in chains.values() for node in chain)],
        connections,
        supervisor=agent.name,
    )


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


def _to_world(
    agent: Supervisor, chain: tuple[Node, ...], port: Ports, hop: Delay, actuation: Delay, world: Node
) -> list[Connection]:
    """The way of the commands from the agent through the action nodes to the world; its last part has `actuation`."""
    connections: list[Connection] = []
    before: Node = agent
    for node in chain:
        known = {"agent": before.name, "sensor": port.sensor, "truth": port.world}
        for name in node.inputs or ("agent",):
            if not known.get(name):
                raise EngineError(
                    f'action node "{node.name}" has an input "{name}"; it can have agent, sensor and truth'
                )
            connections.append(
                Connection(known[name], node.name, delay=hop, blocking=node.advance, name=name)
            )
        before = node
    last = Connection(before.name, port.world, delay=actuation, skip=True, name=port.command)
    return [*connections, wide_enough(last, before, world)]


def _for_agent(agent: Supervisor, connection: Connection) -> list[Connection]:
    """The connection, unless the agent names its inputs and this one is not among them."""
    return [connection] if agent.inputs is None or connection.name in agent.inputs else []


def _by_object(
    what: str, given: Any, objects: Mapping[str, EngineObject], several: bool
) -> dict[str, tuple[Node, ...]]:
    if not several:
        given = {"": given}
    elif not isinstance(given, Mapping):
        if tuple(given):
            raise EngineError(f"{what}: say of which object they are, by name: {', '.join(objects)}")
        given = {}
    for name in given:
        _check_object(what, name, objects)
    return {name: tuple(given.get(name, ())) for name in objects}


def _of(given: Any, name: str, objects: Mapping[str, EngineObject]) -> Any:
    """What is given for all objects, or for this one by name."""
    if isinstance(given, Mapping) and "law" not in given:
        for key in given:
            _check_object("delay", key, objects)
        return given.get(name, 0.0)
    return given


def _entries(
    objects: Mapping[str, EngineObject],
    chains: Mapping[str, tuple[Node, ...]],
    given: Mapping[str, Sequence[int]] | None,
) -> dict[str, tuple[int, ...]]:
    """Entries of the action that each object without action nodes takes."""
    found, first = {}, 0
    for name, each in objects.items():
        size = len(each.actuators)
        if size and not chains[name]:
            found[name] = tuple(range(first, first + size))
        first += size
    for name, own in (given or {}).items():
        _check_object("action_entries", name, objects)
        if len(own) != len(objects[name].actuators) or chains[name]:
            raise EngineError(
                f'action_entries of "{name}": give {len(objects[name].actuators)} entries, one for each actuator, '
                "and none to an object with action nodes"
            )
        found[name] = tuple(own)
    return found


def _check_object(what: str, name: str, objects: Mapping[str, EngineObject]) -> None:
    if name not in objects:
        raise EngineError(
            f'{what}: there is no object "{name}"; there are {", ".join(filter(None, objects)) or "none"}'
        )

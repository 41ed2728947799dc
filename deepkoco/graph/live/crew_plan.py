"""The plan of a crew: which node lives in which process, and what each process needs to know."""

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from deepkoco.graph.live.host import HostPlan, SeatPlan
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Node

Factory = Callable[[], Node]
HERE = 0  # host number of the caller's own process
AWAY = -1  # host number of another machine


@dataclass(frozen=True)
class CrewOptions:
    """Where nodes live and when they have failed.

    Attributes:
        hosts: by node name, number of the process that hosts it; not named or 0: the caller's.
        factories: by node name, functions of a module that make the node in its process.
        time_limit: longest step [s]; a node that takes longer has failed.
        beat_limit: longest time without a heartbeat of a process [s].
        cores: by number of the process, the core it is pinned to.
        priority: real-time priority that the processes ask for; None: none.
        report: the processes send what their nodes record while they run.
        away: nodes that live on another machine.
    """

    hosts: Mapping[str, int]
    factories: Mapping[str, Factory]
    time_limit: float
    beat_limit: float
    cores: Mapping[int, int] = field(default_factory=dict)
    priority: int | None = None
    report: bool = False
    away: frozenset[str] = frozenset()

    def check(self, graph: Graph) -> None:
        """Check that those with a place of their own are nodes other than the supervisor.

        Raises:
            GraphError: one is not.
        """
        for name in (*self.hosts, *self.factories):
            if name not in graph.index:
                raise GraphError(f'"{name}" is no node; known: {", ".join(graph.index)}')
            if name == graph.supervisor:
                raise GraphError(f'supervisor "{name}" stays in the caller\'s thread')


class CrewPlan:
    """Which node lives where.

    Args:
        graph: nodes and connections; the supervisor stays with the caller.
        options: where the nodes live and when they have failed.

    Attributes:
        hosts: by node name, number of the process that hosts it.
        receivers: by number of the connection, number of the node that receives.
    """

    def __init__(self, graph: Graph, options: CrewOptions) -> None:
        self.graph, self.options = graph, options
        self.hosts = {
            node.name: AWAY if node.name in options.away else options.hosts.get(node.name, HERE)
            for node in graph.nodes
        }
        self.receivers = tuple(graph.index[c.receiver] for c in graph.connections)

    def host_plans(self) -> dict[int, HostPlan]:
        """What each host needs to know, by its number.

        Raises:
            GraphError: a node does not travel to its process.
        """
        graph = self.graph
        plans: dict[int, list[SeatPlan]] = {}
        for position, node in enumerate(graph.nodes):
            if node.name == graph.supervisor or self.hosts[node.name] == AWAY:
                continue
            places = input_places(graph, node.name)
            host = self.hosts[node.name]
            outlets = tuple(
                (e, self._way_to(c.receiver), graph.index[c.receiver])
                for e, c in enumerate(graph.connections)
                if c.sender == node.name
            )
            plan = SeatPlan(
                position,
                node.name,
                b"" if host == HERE else self._pack(node),
                tuple(graph.connections[e] for e in places),
                places,
                outlets,
                self.options.time_limit,
            )
            plans.setdefault(host, []).append(plan)
        options = self.options
        return {
            host: HostPlan(host, tuple(seats), options.cores.get(host), options.priority, self.receivers)
            for host, seats in plans.items()
        }

    def pairs(self) -> set[tuple[int, int]]:
        """Hosts between which messages go."""
        pairs = set()
        for connection in self.graph.connections:
            ends = self._way_to(connection.sender), self._way_to(connection.receiver)
            if ends[0] != ends[1]:
                pairs.add((min(ends), max(ends)))
        return pairs

    def _way_to(self, name: str) -> int:
        """The host that a message for a node goes to; the caller's process has the connection to the other machine."""
        return HERE if self.hosts[name] == AWAY else self.hosts[name]

    def own_node(self, plan: SeatPlan) -> Node:
        """The node of a seat in the caller's process."""
        factory = self.options.factories.get(plan.name)
        return self.graph.nodes[plan.position] if factory is None else factory()

    def _pack(self, node: Node) -> bytes:
        packed = self.options.factories.get(node.name, node)
        try:
            return pickle.dumps(packed)
        except Exception as error:
            raise GraphError(
                f'node "{node.name}" does not travel to its process ({error}); acquire what cannot be pickled in '
                "its open(), or give a function of a module that makes the node in factories="
            ) from error


def input_places(graph: Graph, name: str) -> dict[int, int]:
    """By number of the graph's connection, number of the input of a node, in the order of its inputs."""
    into = [edge for edge, connection in enumerate(graph.connections) if connection.receiver == name]
    return {edge: place for place, edge in enumerate(into)}

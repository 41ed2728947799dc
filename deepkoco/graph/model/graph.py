"""Graphs: nodes and connections that fit together."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

from deepkoco.graph.delay import (
    DelayError,
    RankCorrelation,
    Stalls,
    exact_seconds,
    make_correlation,
    make_stalls,
)
from deepkoco.graph.model.calls import check_asked
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.node import GraphError, Node, Supervisor
from deepkoco.graph.model.parts import Parts, PartsError


class Graph:
    """Nodes and connections, checked, with the order and the phases that follow from them.

    The phase of a node is the time of its first tick: the largest over its inputs that are not skipped
    of the sender's phase plus its expected computation delay plus the expected communication delay.

    Args:
        nodes: nodes with different names.
        connections: between these nodes; without those that skip they have no cycle.
        supervisor: name of the node whose output comes from outside.
        correlations: rank correlations between delays of one publisher, or their descriptions.
        stalls: stalls that hold up several channels at once, or their descriptions.

    Attributes:
        parts: by node name, where the tensors of an output lie that is a dict; `parts[name].split_array`
            takes apart what an episode has of the node.

    Raises:
        GraphError: names the node, connection or cycle that does not fit.
        DelayError: a correlation or stall names no channel, or channels that do not belong together.
    """

    def __init__(
        self,
        nodes: Iterable[Node],
        connections: Iterable[Connection],
        supervisor: str = "agent",
        *,
        correlations: Iterable[RankCorrelation | Mapping[str, Any]] = (),
        stalls: Iterable[Stalls | Mapping[str, Any]] = (),
    ) -> None:
        self.nodes = tuple(nodes)
        self.connections = tuple(connections)
        self.supervisor = supervisor
        self.index = {node.name: position for position, node in enumerate(self.nodes)}
        self.kept: dict[str, Any] = {}
        """What others work out of this graph once and keep with it."""
        self._check()
        self.parts = self._parts()
        self.connections = tuple(
            replace(c, parts=self.parts.get(c.sender)) if c.parts or c.sender in self.parts else c
            for c in self.connections
        )
        self.order = self._topological_order()
        self.phases = self._phases()
        self.correlations, self.stalls = check_coupling(self, correlations, stalls)

    @property
    def constant(self) -> bool:
        """Whether all delays are constant, so that every episode has the same timing."""
        laws = [node.delay for node in self.nodes] + [connection.law for connection in self.connections]
        return not self.stalls and all(law.constant for law in laws)

    def node(self, name: str) -> Node:
        """Return the node of that name."""
        return self.nodes[self.index[name]]

    def inputs_of(self, name: str) -> tuple[Connection, ...]:
        """Return the connections into a node."""
        return tuple(connection for connection in self.connections if connection.receiver == name)

    def check_nodes(self, names: Iterable[str]) -> None:
        """Check that names are those of nodes.

        Raises:
            ValueError: one is not.
        """
        for name in names:
            if name not in self.index:
                raise ValueError(f'"{name}" is no node; known: {", ".join(self.index)}')

    def _check(self) -> None:
        names = [node.name for node in self.nodes]
        for name in names:
            if names.count(name) > 1:
                raise GraphError(f'{names.count(name)} nodes are called "{name}"; names are unique')
        known = f"known: {', '.join(names)}"
        if self.supervisor not in names:
            raise GraphError(f'supervisor "{self.supervisor}" is no node; {known}')
        for node in self.nodes:
            if isinstance(node, Supervisor) and node.name != self.supervisor:
                raise GraphError(
                    f'node "{node.name}" is a Supervisor, but the supervisor is "{self.supervisor}"; '
                    "a graph has one"
                )
            check_asked(node)
        seen: set[str] = set()
        for connection in self.connections:
            for end in (connection.sender, connection.receiver):
                if end not in names:
                    raise GraphError(f'connection "{connection.key}": "{end}" is no node; {known}')
            place = f"{connection.receiver}.{connection.name}"
            if place in seen:
                raise GraphError(f'input "{place}" is connected twice; give one connection another name')
            seen.add(place)
            expected = self.node(connection.receiver).inputs
            if expected is not None and connection.name not in expected:
                raise GraphError(
                    f'connection "{connection.key}": node "{connection.receiver}" has no input '
                    f'"{connection.name}"; it has {", ".join(expected) or "none"}'
                )
        for node in self.nodes:
            for name in node.inputs or ():
                if f"{node.name}.{name}" not in seen:
                    raise GraphError(f'input "{name}" of node "{node.name}" is not connected')

    def _parts(self) -> dict[str, Parts]:
        """The parts of the outputs that are dicts, by node name."""
        found = {}
        for node in self.nodes:
            if node.outputs is None:
                continue
            if node.name == self.supervisor:
                raise GraphError(
                    f'supervisor "{node.name}": its output is the action, one tensor; leave outputs out'
                )
            try:
                found[node.name] = Parts.of(node.outputs)
            except PartsError as error:
                raise GraphError(f'node "{node.name}": outputs: {error}') from error
        return found

    def _topological_order(self) -> tuple[int, ...]:
        """Order the nodes so that messages that are not skipped go forward; first named, first placed."""
        senders = {
            node.name: {c.sender for c in self.inputs_of(node.name) if not c.skip} for node in self.nodes
        }
        order: list[int] = []
        while len(order) < len(self.nodes):
            placed = {self.nodes[position].name for position in order}
            free = [n.name for n in self.nodes if n.name not in placed and senders[n.name] <= placed]
            if not free:
                raise GraphError(f"cycle without a skipped connection: {self._cycle(senders, placed)}")
            order.append(self.index[free[0]])
        return tuple(order)

    def _cycle(self, senders: dict[str, set[str]], placed: set[str]) -> str:
        path = [next(node.name for node in self.nodes if node.name not in placed)]
        while path.count(path[-1]) < 2:
            path.append(min(senders[path[-1]] - placed))
        cycle = path[path.index(path[-1]) :]
        return f"{' -> '.join(reversed(cycle))}; set skip=True on one of these connections"

    def _phases(self) -> tuple[Fraction, ...]:
        phases: dict[str, Fraction] = {}
        for position in self.order:
            node = self.nodes[position]
            arrivals = [
                phases[c.sender] + exact_seconds(self.node(c.sender).delay) + exact_seconds(c.law)
                for c in self.inputs_of(node.name)
                if not c.skip
            ]
            phases[node.name] = max(arrivals, default=Fraction(0)) if node.phase is None else node.phase
        return tuple(phases[node.name] for node in self.nodes)


def check_coupling(
    graph: Graph,
    correlations: Iterable[RankCorrelation | Mapping[str, Any]],
    stalls: Iterable[Stalls | Mapping[str, Any]],
) -> tuple[tuple[RankCorrelation, ...], tuple[Stalls, ...]]:
    """Check that correlations and stalls name channels of a graph.

    Raises:
        DelayError: one names no channel, or correlates channels of different publishers.
    """
    made = tuple(map(make_correlation, correlations)), tuple(map(make_stalls, stalls))
    senders = {node.name: node.name for node in graph.nodes} | {c.key: c.sender for c in graph.connections}
    seen: set[str] = set()
    for item in (*made[0], *made[1]):
        kind = "rank correlation" if isinstance(item, RankCorrelation) else "stalls"
        for key in item.channels or ():
            if key not in senders:
                raise DelayError(f'{kind}: "{key}" is no node or connection; known: {", ".join(senders)}')
    for correlation in made[0]:
        publishers = sorted({senders[key] for key in correlation.channels})
        if len(publishers) > 1:
            raise DelayError(
                f"rank correlation of {' and '.join(correlation.channels)}: they belong to "
                f"{' and '.join(publishers)}; delays are correlated step by step, so of one publisher"
            )
        twice = sorted(seen & set(correlation.channels))
        if twice:
            raise DelayError(f'rank correlation: "{twice[0]}" is in two; give one matrix for all of them')
        seen |= set(correlation.channels)
    return made

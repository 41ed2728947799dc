"""A file from which both ends take their graph: functions `graph`, `policy` and, if nodes need it, `parameters`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import FunctionType
from typing import Any

from deepkoco.graph.live.crew_plan import Factory
from deepkoco.graph.live.state import Policy
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Node
from deepkoco.own_objects import OwnObjectError, find_object


@dataclass(frozen=True)
class GraphFile:
    """What a file says of a graph.

    Attributes:
        text: the file, as it was named.
        graph: what its function `graph` returns.
    """

    text: str
    graph: Graph

    def policy(self) -> Policy:
        """Its function `policy`, from what the supervisor sees to its action (1, M).

        Raises:
            OwnObjectError: it has none.
        """
        return _function(self.text, "policy")

    def parameters(self) -> Mapping[str, Any]:
        """What its function `parameters` returns, parameters by name of the node; none if it has no such function."""
        try:
            made = _function(self.text, "parameters")()
        except OwnObjectError as error:
            if "has no parameters" in str(error):
                return {}
            raise
        if not isinstance(made, Mapping):
            raise OwnObjectError(
                f'"{self.text}": parameters() returns a {type(made).__name__}; return a dict by node'
            )
        return made

    def factories(self, names: set[str] | frozenset[str]) -> dict[str, Factory]:
        """By node name, what makes it in its own process, where the file is read again."""
        return {name: partial(node_from, self.text, name) for name in names}


def read_graph_file(text: str) -> GraphFile:
    """Run a file and its function `graph`.

    Args:
        text: path of a Python file.

    Raises:
        OwnObjectError: there is no such file, it fails, or `graph` does not return a graph.
    """
    graph = _function(text, "graph")()
    if not isinstance(graph, Graph):
        raise OwnObjectError(
            f'"{text}": graph() returns a {type(graph).__name__}; return a deepkoco.graph.Graph'
        )
    return GraphFile(text, graph)


def node_from(text: str, name: str) -> Node:
    """The node of that name in the graph of a file."""
    return read_graph_file(text).graph.node(name)


def _function(text: str, name: str) -> Callable[..., Any]:
    if not text.endswith(".py"):
        raise OwnObjectError(f'"{text}": give a Python file with a function "graph" that returns the graph')
    return find_object(f"{text}:{name}", FunctionType).value

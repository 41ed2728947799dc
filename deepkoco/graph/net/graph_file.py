"""A file from which both ends take their graph: functions `graph`, `policy` and, if nodes need it, `parameters`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import Any

from deepkoco.graph.live.crew_plan import Factory
from deepkoco.graph.live.state import Policy
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Node
from deepkoco.graph.setup import SetupError, apply_parameters, apply_setup, read_setup
from deepkoco.own_objects import OwnObjectError, find_object


@dataclass(frozen=True)
class GraphFile:
    """What a file says of a graph.

    Attributes:
        text: the file, as it was named.
        graph: what its function `graph` returns, with the setup.
        setup: file whose rates, delays, windows and parameters it has in the place of its own.
    """

    text: str
    graph: Graph
    setup: Path | None = None

    def policy(self) -> Policy:
        """Its function `policy`, from what the supervisor sees to its action (1, M).

        Raises:
            OwnObjectError: it has none.
        """
        return _function(self.text, "policy")

    def parameters(self) -> Mapping[str, Any]:
        """What its function `parameters` returns, by name of the node, with the setup; none without such a function.

        Raises:
            SetupError: the setup has a parameter that is not there.
        """
        try:
            made = _function(self.text, "parameters")()
        except OwnObjectError as error:
            if "has no parameters" not in str(error):
                raise
            made = {}
        if not isinstance(made, Mapping):
            raise OwnObjectError(
                f'"{self.text}": parameters() returns a {type(made).__name__}; return a dict by node'
            )
        if self.setup is None:
            return made
        try:
            return apply_parameters(made, read_setup(self.setup))
        except SetupError as error:
            raise _in_file(self.setup, error) from error

    def factories(self, names: set[str] | frozenset[str]) -> dict[str, Factory]:
        """By node name, what makes it in its own process, where the file is read again."""
        return {name: partial(node_from, self.text, name, self.setup) for name in names}


def read_graph_file(text: str, setup: Path | None = None) -> GraphFile:
    """Run a file and its function `graph`.

    Args:
        text: path of a Python file.
        setup: YAML file with rates, delays, windows and parameters in the place of those of the Python file.

    Raises:
        OwnObjectError: there is no such file, it fails, or `graph` does not return a graph.
        SetupError: the setup cannot be read, or does not fit the graph.
    """
    graph = _function(text, "graph")()
    if not isinstance(graph, Graph):
        raise OwnObjectError(
            f'"{text}": graph() returns a {type(graph).__name__}; return a deepkoco.graph.Graph'
        )
    if setup is not None:
        try:
            graph = apply_setup(graph, read_setup(setup))
        except SetupError as error:
            raise _in_file(setup, error) from error
    return GraphFile(text, graph, setup)


def node_from(text: str, name: str, setup: Path | None = None) -> Node:
    """The node of that name in the graph of a file."""
    return read_graph_file(text, setup).graph.node(name)


def _in_file(setup: Path, error: SetupError) -> SetupError:
    """The error with the name of the file, where it does not begin with it."""
    return error if str(error).startswith(str(setup)) else SetupError(f"{setup}: {error}")


def _function(text: str, name: str) -> Callable[..., Any]:
    if not text.endswith(".py"):
        raise OwnObjectError(f'"{text}": give a Python file with a function "graph" that returns the graph')
    return find_object(f"{text}:{name}", FunctionType).value

"""Descriptions of graphs in plain JSON, and graphs made from them that know times but no code."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.delay import LAWS, Delay, DelayError, make_delay
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Input, Node, Parameters, State

_OPTIONS = ("window", "skip", "blocking", "jitter", "fifo", "name")


@dataclass(frozen=True)
class RecordedDelay(Delay):
    """A law that the program which reads does not know: its description, mean and bound [s], but no draws."""

    description: Mapping[str, Any] = field(hash=False)
    expected: float
    bound: float
    law = "recorded"

    @property
    def mean(self) -> float:
        return self.expected

    @property
    def highest(self) -> float:
        return self.bound

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        raise DelayError(
            f'delay law "{self.description.get("law")}" is not known here, so nothing can be drawn from it; '
            f"known: {', '.join(LAWS)}"
        )

    def to_dict(self) -> dict[str, Any]:
        return dict(self.description)


class RecordedNode(Node):
    """A node as a recording describes it: name, rate and delay, but nothing to run.

    Args:
        name, rate, delay, scheduling, advance, phase: as for `Node`.
        kind: class of the node that was recorded.
    """

    def __init__(self, name: str, rate: Fraction, *, kind: str, **options: Any) -> None:
        super().__init__(name, rate, **options)
        self.kind = kind

    def _refuse(self) -> GraphError:
        return GraphError(
            f'node "{self.name}" comes from a recording, which holds its times and outputs but not the code of '
            f"its class {self.kind}; build the graph with that class to run it"
        )

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        raise self._refuse()

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        raise self._refuse()

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        raise self._refuse()


def describe_graph(graph: Graph) -> dict[str, Any]:
    """Describe nodes, rates, delays and connections in JSON types; rates and phases are exact fractions.

    Returns:
        What `graph_from_description` takes.
    """
    nodes = []
    for node in graph.nodes:
        nodes.append(
            {
                "name": node.name,
                "kind": node.kind if isinstance(node, RecordedNode) else type(node).__name__,
                "rate_hz": str(node.rate),
                "delay": _describe_delay(node.delay),
                "scheduling": node.scheduling,
                "advance": node.advance,
                "phase_s": None if node.phase is None else str(node.phase),
            }
            | _describe_parts(node)
        )
    connections = []
    for connection in graph.connections:
        ends = {"sender": connection.sender, "receiver": connection.receiver}
        options = {option: getattr(connection, option) for option in _OPTIONS}
        connections.append(ends | {"delay": _describe_delay(connection.law)} | options)
    return {
        "supervisor": graph.supervisor,
        "nodes": nodes,
        "connections": connections,
        "correlations": [correlation.to_dict() for correlation in graph.correlations],
        "stalls": [stalls.to_dict() for stalls in graph.stalls],
    }


def _describe_parts(node: Node) -> dict[str, Any]:
    """Shapes and types of an output that is a dict; nothing where it is one tensor."""
    if node.outputs is None:
        return {}
    types = {name: str(dtype).removeprefix("torch.") for name, (_, dtype) in node.outputs.items()}
    return {"outputs": {name: [list(shape), types[name]] for name, (shape, _) in node.outputs.items()}}


def _type(name: str) -> torch.dtype:
    dtype = getattr(torch, name, None)
    if not isinstance(dtype, torch.dtype):
        raise ValueError(f'"{name}" is no type of a tensor')
    return dtype


def graph_from_description(description: Mapping[str, Any]) -> Graph:
    """Make a graph of `RecordedNode`s: good for timing, fits and pictures, not for running.

    Raises:
        GraphError, DelayError, KeyError, TypeError, ValueError: the description is not one of a graph.
    """
    nodes = [
        RecordedNode(
            node["name"],
            Fraction(node["rate_hz"]),
            kind=node["kind"],
            delay=_delay(node["delay"]),
            scheduling=node["scheduling"],
            advance=node["advance"],
            phase=None if node["phase_s"] is None else Fraction(node["phase_s"]),
        )
        for node in description["nodes"]
    ]
    for node, described in zip(nodes, description["nodes"], strict=True):
        if "outputs" in described:
            node.outputs = {
                name: (tuple(shape), _type(dtype)) for name, (shape, dtype) in described["outputs"].items()
            }
    connections = [
        Connection(**connection | {"delay": _delay(connection["delay"])})
        for connection in description["connections"]
    ]
    laws = [node.delay for node in nodes] + [connection.law for connection in connections]
    if any(isinstance(law, RecordedDelay) for law in laws):
        return Graph(nodes, connections, description["supervisor"])  # nothing can be drawn, coupled or not
    coupling = {name: description[name] for name in ("correlations", "stalls")}
    return Graph(nodes, connections, description["supervisor"], **coupling)


def _describe_delay(law: Delay) -> dict[str, Any]:
    highest = law.highest if math.isfinite(law.highest) else None
    return {"law": law.to_dict(), "mean_s": law.mean, "highest_s": highest}


def _delay(description: Mapping[str, Any]) -> Delay:
    if description["law"].get("law") in LAWS:
        return make_delay(description["law"])
    highest = math.inf if description["highest_s"] is None else description["highest_s"]
    return RecordedDelay(description["law"], description["mean_s"], highest)

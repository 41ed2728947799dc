"""Descriptions of graphs in plain JSON, and graphs made from them that know times but no code."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.delay import LAWS, Delay, DelayError, make_delay
from deepkoco.graph.delay.law import seconds
from deepkoco.graph.episodes.storage.checks import LARGEST_SEQ, MOST_AXES
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Input, Node, Parameters, State

MOST_NODES, MOST_CONNECTIONS = 1000, 10_000
"""Of a graph that is read: checking takes time that grows with their square."""
_FRACTION = re.compile(r"[0-9]{1,40}(/[0-9]{1,40})?")
_ENTRIES = {
    "sender": str, "receiver": str, "window": int, "skip": bool, "blocking": bool, "jitter": str, "fifo": bool,
    "name": str,
}  # fmt: skip
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

    free_rate = True

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


def _parts(described: Mapping[str, Any]) -> dict[str, tuple[tuple[int, ...], torch.dtype]]:
    """Shapes and types of an output that is a dict, from their description."""
    parts = {}
    for name, (shape, dtype) in described.items():
        if len(shape) > MOST_AXES or not all(
            type(size) is int and 0 <= size <= LARGEST_SEQ for size in shape
        ):
            raise ValueError(f'part "{name[:50]}": {str(shape)[:80]} is no shape')
        parts[name] = (tuple(shape), _type(dtype))
    return parts


def graph_from_description(description: Mapping[str, Any]) -> Graph:
    """Make a graph of `RecordedNode`s: good for timing, fits and pictures, not for running.

    Raises:
        GraphError, DelayError, KeyError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError: the
            description is not one of a graph.
    """
    if len(description["nodes"]) > MOST_NODES or len(description["connections"]) > MOST_CONNECTIONS:
        raise GraphError(f"more than {MOST_NODES} nodes or {MOST_CONNECTIONS} connections")
    nodes = [
        RecordedNode(
            _typed(node, "name", str),
            _fraction(node["rate_hz"]),
            kind=_typed(node, "kind", str),
            delay=_delay(node["delay"]),
            scheduling=_typed(node, "scheduling", str),
            advance=_typed(node, "advance", bool),
            phase=None if node["phase_s"] is None else _fraction(node["phase_s"]),
        )
        for node in description["nodes"]
    ]
    for node, described in zip(nodes, description["nodes"], strict=True):
        if "outputs" in described:
            node.outputs = _parts(_typed(described, "outputs", dict))
    connections = []
    for connection in description["connections"]:
        for name, kind in _ENTRIES.items():
            if name in connection:
                _typed(connection, name, kind)
        connections.append(Connection(**connection | {"delay": _delay(connection["delay"])}))
    laws = [node.delay for node in nodes] + [connection.law for connection in connections]
    if any(isinstance(law, RecordedDelay) for law in laws):
        return Graph(nodes, connections, description["supervisor"])  # nothing can be drawn, coupled or not
    coupling = {name: description[name] for name in ("correlations", "stalls")}
    return Graph(nodes, connections, description["supervisor"], **coupling)


def _describe_delay(law: Delay) -> dict[str, Any]:
    highest = law.highest if math.isfinite(law.highest) else None
    return {"law": law.to_dict(), "mean_s": law.mean, "highest_s": highest}


def _delay(description: Mapping[str, Any]) -> Delay:
    law = _typed(description, "law", dict)
    for name in ("mean_s", "highest_s"):
        if type(description[name]) not in (int, float) and (
            name == "mean_s" or description[name] is not None
        ):
            raise TypeError(f"{name} {str(description[name])[:80]} is no number")
    mean = seconds("mean_s", description["mean_s"])
    highest = math.inf if description["highest_s"] is None else seconds("highest_s", description["highest_s"])
    known = _typed(law, "law", str) in LAWS
    return make_delay(law) if known else RecordedDelay(law, mean, highest)


def _typed(content: Mapping[str, Any], name: str, kind: type) -> Any:
    if type(content[name]) is not kind:
        raise TypeError(f"{name} {str(content[name])[:80]} is no {kind.__name__}")
    return content[name]


def _fraction(text: Any) -> Fraction:
    """Read a fraction as `str` writes it: one like 1e999999999 would take forever."""
    if not isinstance(text, str) or not _FRACTION.fullmatch(text):
        raise ValueError(f"{str(text)[:80]} is no fraction of whole numbers")
    return Fraction(text)

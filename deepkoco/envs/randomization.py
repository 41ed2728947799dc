"""Randomization: what the names mean for which environments draw numbers of their own."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from deepkoco.envs.delay_traces import Delays, law_ranges
from deepkoco.envs.settings import SettingsError, check_range
from deepkoco.graph import Graph

Values = Mapping[str, Mapping[str, Tensor | float]]
Randomize = Mapping[str, tuple[float, float] | Mapping[str, Any]]
Bounds = Callable[[str], tuple[float, float, str]]
"""Smallest and largest value that a name may have, and its unit."""


class Randomization(Protocol):
    """What environments draw for an episode, and what follows from it.

    Attributes:
        ranges: Name -> (low, high) of each number that is drawn.
        timed: Names that say when things happen; these are drawn with the delay traces.
    """

    ranges: dict[str, tuple[float, float]]
    timed: set[str]

    def delays(self, draws: Mapping[str, Tensor]) -> Delays:
        """Delays by connection key or node name, (R,) [s] or laws, from what the traces have drawn."""
        ...

    def parameters(self, drawn: Mapping[str, Tensor]) -> Mapping[str, Mapping[str, Tensor]]:
        """Parameters of every node, from what the environments have drawn, (B,) each."""
        ...


class GraphRandomization:
    """Randomization by the names of a graph: ``"node.parameter"``, ``"sender->receiver"`` or ``"node"``.

    Args:
        graph: Nodes and connections.
        values: Values of parameters by node and name.
        randomize: Name -> (low, high), or the description of a delay law with ranges in it.

    Raises:
        ValueError: A name is not known, or a range is none.
    """

    def __init__(self, graph: Graph, values: Values, randomize: Randomize) -> None:
        self._graph = graph
        self._values = {node: dict(own) for node, own in values.items()}
        self._channels = set(graph.index) | {connection.key for connection in graph.connections}
        self._laws = {name: law for name, law in randomize.items() if isinstance(law, Mapping)}
        self.ranges, self.timed = read_ranges(randomize, self._channels, self._bounds)

    def delays(self, draws: Mapping[str, Tensor]) -> Delays:
        numbers = {name: value.numpy() for name, value in draws.items()}
        delays: dict[str, Any] = {name: value for name, value in numbers.items() if name in self._channels}
        for name, law in self._laws.items():
            delays[name] = {key: numbers.get(f"{name}.{key}", value) for key, value in law.items()}
        return delays

    def parameters(self, drawn: Mapping[str, Tensor]) -> Mapping[str, Mapping[str, Tensor]]:
        values = {
            node: {k: torch.as_tensor(v, dtype=torch.float64) for k, v in own.items()}
            for node, own in self._values.items()
        }
        for name, value in drawn.items():
            node, _, parameter = name.partition(".")
            if name not in self.timed:
                values.setdefault(node, {})[parameter] = value
        return values

    def _bounds(self, name: str) -> tuple[float, float, str]:
        if name in self._channels:
            return 0.0, math.inf, "s"
        node, _, parameter = name.partition(".")
        if node not in self._graph.index or not parameter:
            known = f"{', '.join(sorted(self._channels))} or NODE.PARAMETER"
            raise SettingsError(f'randomize: "{name}" is none of {known}')
        return -math.inf, math.inf, ""


def read_ranges(
    randomize: Randomize, timed: set[str], bounds: Bounds
) -> tuple[dict[str, tuple[float, float]], set[str]]:
    """Read the ranges that environments draw from.

    Args:
        randomize: Name -> (low, high), or the description of a delay law with ranges in it.
        timed: Names that say when things happen.
        bounds: Of a name.

    Returns:
        Name -> (low, high), and the names that say when things happen, with those of the numbers of laws.

    Raises:
        ValueError: A name is not known, or a range is none.
    """
    ranges: dict[str, tuple[float, float]] = {}
    for name, span in randomize.items():
        if isinstance(span, Mapping):
            own = law_ranges(name, span, known=timed)
            timed = timed | set(own)
            ranges |= own
        else:
            check_range(name, span, *bounds(name))
            ranges[name] = span
    return ranges, timed

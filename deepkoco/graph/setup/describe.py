"""The setup of a graph in plain values."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import torch

from deepkoco.graph.delay import Delay
from deepkoco.graph.delay.law import exact_fraction
from deepkoco.graph.model.graph import Graph

MOST_NUMBERS = 64
"""Parameters of more numbers, such as the weights of a network, are not part of a setup."""
OF_A_NODE = ("rate", "delay", "scheduling", "advance", "phase")
OF_A_CONNECTION = ("delay", "window", "skip", "blocking", "jitter", "fifo")


def describe_setup(graph: Graph, parameters: Mapping[str, Mapping[str, Any]] | None = None) -> dict[str, Any]:
    """Describe rates, delays, windows, coupling and parameters of a graph.

    Args:
        graph: what is described.
        parameters: by node and name, numbers or tensors; of more than `MOST_NUMBERS` numbers they are left out.

    Returns:
        ``nodes`` by name: ``rate`` [Hz], ``delay`` [s], ``scheduling``, ``advance``, ``phase`` [s] or None.
        ``connections`` by key: ``delay`` [s], ``window``, ``skip``, ``blocking``, ``jitter``, ``fifo``.
        ``correlations`` and ``stalls``, lists of their descriptions. ``parameters`` by node and name, numbers or lists.
        All in numbers, strings, lists and dicts; a rate or phase that is no simple float is a fraction "p/q".
    """
    nodes, connections = {}, {}
    for node in graph.nodes:
        timing = {"rate": _number(node.rate), "delay": _delay(node.delay)}
        phase = None if node.phase is None else _number(node.phase)
        nodes[node.name] = {**timing, "scheduling": node.scheduling, "advance": node.advance, "phase": phase}
    for connection in graph.connections:
        options = {name: getattr(connection, name) for name in OF_A_CONNECTION[1:]}
        connections[connection.key] = {"delay": _delay(connection.law)} | options
    return {
        "nodes": nodes,
        "connections": connections,
        "correlations": [correlation.to_dict() for correlation in graph.correlations],
        "stalls": [stalls.to_dict() for stalls in graph.stalls],
        "parameters": _parameters(parameters or {}),
    }


def _number(value: Fraction) -> float | int | str:
    if value.denominator == 1:
        return int(value)
    return float(value) if exact_fraction(float(value)) == value else str(value)


def _delay(law: Delay) -> Any:
    """A constant as its seconds, another law as its description in plain values."""
    return law.mean if law.law == "deterministic" else _plain(law.to_dict())


def _parameters(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    kept: dict[str, dict[str, Any]] = {}
    for node, own in parameters.items():
        for name, value in own.items():
            numbers = torch.as_tensor(value)
            if numbers.numel() <= MOST_NUMBERS and not numbers.is_complex():
                kept.setdefault(node, {})[name] = numbers.tolist()
    return kept


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

"""Sensors that a replay compares with their recording: which, over which connection, and what was recorded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.model.connection import LONGEST_WINDOW, Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Node
from deepkoco.graph.timing.computation_graph import ComputationGraph


def compared_names(
    graph: Graph, running: Mapping[str, Node], recorded: Episode, compare: Iterable[str] | None
) -> tuple[str, ...]:
    replaced = [name for name in running if name in graph.index]
    if compare is None:
        return tuple(name for name in replaced if name in recorded.outputs)
    names = tuple(compare)
    for name in names:
        if name not in replaced or name not in recorded.outputs:
            raise GraphError(
                f'compare "{name}": it is no recorded node that runs in the replay; those are '
                f"{', '.join(replaced) or 'none'}"
            )
    return names


def showing_connection(graph: Graph, recorded: Episode, sender: str) -> Connection:
    """A connection that shows the supervisor, at each of its steps, all messages since the one before."""
    acts, sent = recorded.t_start[graph.supervisor], recorded.t_end[sender]
    window = int(np.diff(np.searchsorted(sent, acts)).max(initial=1))
    name = f"{sender} compared"
    # It skips, so that it cannot close a cycle.
    return Connection(sender, graph.supervisor, window=min(window, LONGEST_WINDOW), skip=True, name=name)


def recorded_readings(
    graph: Graph, timing: ComputationGraph, recorded: Episode, connection: Connection
) -> dict[str, np.ndarray]:
    """By reading, (steps, window, ...) what was recorded of the messages that it shows, each of them once."""
    edge = timing.layout.connections.index(connection.key)
    seen = timing.windows_of(edge)
    new = seen[1:] > np.maximum(seen[:-1].max(axis=1, keepdims=True), -1)
    outputs = recorded.outputs[connection.sender]
    parts = graph.parts.get(connection.sender)
    name = connection.sender
    values = {name: outputs} if parts is None else {
        f"{name}.{part}": value for part, value in parts.split_array(outputs).items()
    }  # fmt: skip
    shown = {}
    for reading, value in values.items():
        taken = value[np.clip(seen[1:], 0, len(value) - 1)].astype(np.float64)
        shown[reading] = np.where(new.reshape(*new.shape, *(1,) * (value.ndim - 1)), taken, np.nan)
    return shown

"""Where the steps, messages and windows of a graph lie in the columns of its computation graphs."""

from dataclasses import dataclass

import numpy as np

from deepkoco.graph.model.graph import Graph


@dataclass(frozen=True)
class Layout:
    """Where the steps, messages and windows of a graph lie in the columns of a computation graph.

    Attributes:
        names: (N,) nodes in the order of the graph.
        connections: (E,) keys of the connections.
        sender, receiver, window: (E,) per connection.
        step_base: (N + 1,) node n's step k is column step_base[n] + k.
        message_base: (E + 1,) connection e's message i is column message_base[e] + i.
        window_base: (E + 1,) what step k of the receiver sees on connection e are the `window[e]` columns
            from window_base[e] + k * window[e].
        supervisor: index of the supervisor.
    """

    names: tuple[str, ...]
    connections: tuple[str, ...]
    sender: np.ndarray
    receiver: np.ndarray
    window: np.ndarray
    step_base: np.ndarray
    message_base: np.ndarray
    window_base: np.ndarray
    supervisor: int


def layout_of(graph: Graph, capacity: np.ndarray) -> Layout:
    """Lay out the columns for at most capacity[n] steps of node n."""
    sender = np.array([graph.index[c.sender] for c in graph.connections], dtype=np.int64)
    receiver = np.array([graph.index[c.receiver] for c in graph.connections], dtype=np.int64)
    window = np.array([c.window for c in graph.connections], dtype=np.int64)
    return Layout(
        names=tuple(node.name for node in graph.nodes),
        connections=tuple(connection.key for connection in graph.connections),
        sender=sender,
        receiver=receiver,
        window=window,
        step_base=_bases(capacity),
        message_base=_bases(capacity[sender]),
        window_base=_bases(capacity[receiver] * window),
        supervisor=graph.index[graph.supervisor],
    )


def _bases(sizes: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

"""What pictures say about a node or a connection."""

from __future__ import annotations

from deepkoco.graph.delay import Delay, DelayError
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Node


def milliseconds(seconds: float) -> str:
    """Write a time in milliseconds with about two digits, "0.25", "3.1", "120"."""
    value = 1000 * seconds
    return f"{value:.2f}".rstrip("0").rstrip(".") if value < 1 else f"{value:.{1 if value < 10 else 0}f}"


def delay_words(law: Delay) -> str:
    """Mean of a delay and where nine draws in ten lie, "5.2 (3.1–9.4) ms"; empty for no delay."""
    if law.constant:
        return "" if law.mean == 0.0 else f"{1000 * law.mean:.3g} ms"
    try:
        low, high = (float(law.marginal.quantile(level)) for level in (0.05, 0.95))  # pyright: ignore[reportArgumentType]
    except DelayError:
        return f"{milliseconds(law.mean)} ms"
    return f"{milliseconds(law.mean)} ({milliseconds(low)}–{milliseconds(high)}) ms"


def node_words(node: Node) -> list[str]:
    """Lines below the name of a node: rate and scheduling, computation delay."""
    rate = f"{float(node.rate):.4g} Hz"
    if node.advance:
        rate += ", advances"
    elif node.scheduling == "phase":
        rate += ", catches up"
    delay = delay_words(node.delay)
    return [rate, delay] if delay else [rate]


def loop_words(graph: Graph, node: Node) -> list[str]:
    """Lines on what a node hears from itself."""
    own = [c for c in graph.inputs_of(node.name) if c.sender == node.name]
    return [" ".join(("hears itself", *connection_words(c))) for c in own]


def connection_words(connection: Connection) -> list[str]:
    """Lines on a connection: its delay; window, jitter buffer and order where they are not the usual."""
    lines = [delay_words(connection.law)]
    lines.append(f"window {connection.window}" if connection.window > 1 else "")
    lines.append("buffered" if connection.jitter == "buffer" else "")
    lines.append("" if connection.fifo else "any order")
    if connection.name != connection.sender:
        lines.insert(0, f"“{connection.name}”")
    return [line for line in lines if line]


def graph_words(graph: Graph) -> str:
    """One sentence about a graph."""
    return f"{len(graph.nodes)} nodes, {len(graph.connections)} connections, supervisor {graph.supervisor}"

"""Graphs and parameters with a setup in the place of their own."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph.delay import DelayError, make_delay
from deepkoco.graph.delay.law import exact_fraction
from deepkoco.graph.model.connection import Connection, wide_enough
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import SCHEDULINGS, GraphError, Node
from deepkoco.graph.setup.file import SetupError, check_setup, exact_number
from deepkoco.suggestion import did_you_mean
from deepkoco.yaml_file import shown


def apply_setup(graph: Graph, setup: Mapping[str, Any]) -> Graph:
    """Return the graph with another setup; the graph that is given stays as it is.

    What the setup does not name stays. A window that it does not name grows where the receiver needs more messages with
    the new rates and delays, see `Node.least_window`.

    Args:
        graph: nodes with their code.
        setup: as `describe_setup` returns it or `read_setup` reads it, of this graph or of a recording of it.

    Raises:
        SetupError: it names a node or connection that the graph does not have, a value does not fit, a window is too
            small for the new rates and delays, or the rate of a node must stay because the node, or one that hears it,
            has worked out something from it.
    """
    setup = check_setup(setup)
    nodes, connections = setup.get("nodes", {}), setup.get("connections", {})
    _named("nodes", nodes, graph.index)
    _named("connections", connections, [c.key for c in graph.connections])
    try:
        changed = {node.name: _node(node, nodes.get(node.name) or {}) for node in graph.nodes}
        for connection in graph.connections:
            sender = graph.node(connection.sender)
            if changed[sender.name].rate != sender.rate:
                changed[connection.receiver].check_free(f"the {float(sender.rate):g} Hz of {sender.name}")
        made = [_connection(graph, c, connections.get(c.key) or {}, changed) for c in graph.connections]
        return Graph(
            changed.values(),
            made,
            graph.supervisor,
            correlations=setup.get("correlations", graph.correlations),
            stalls=setup.get("stalls", graph.stalls),
        )
    except (GraphError, DelayError) as error:
        raise SetupError(str(error)) from error


def apply_parameters(
    parameters: Mapping[str, Mapping[str, Any]], setup: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return parameters with those of a setup in the place of their own.

    Args:
        parameters: by node and name, numbers or tensors.
        setup: as for `apply_setup`; a single number fills the whole tensor.

    Raises:
        SetupError: it names a parameter that is not there, or a value has another shape or does not fit the type.
    """
    given = check_setup(setup).get("parameters", {})
    _named("parameters", given, parameters)
    made = {node: dict(own) for node, own in parameters.items()}
    for node, values in given.items():
        _named(f"parameters: {node}", values or {}, made[node])
        for name, value in (values or {}).items():
            made[node][name] = _filled(f"parameters: {node}: {name}", made[node][name], value)
    return made


def _node(node: Node, given: Mapping[str, Any]) -> Node:
    place = f"nodes: {node.name}"
    made = node.at_rate(exact_number(f"{place}: rate", given["rate"])) if "rate" in given else copy.copy(node)
    if "delay" in given:
        made.delay = make_delay(given["delay"])
        if made.delay.loses:
            raise SetupError(f"{place}: delay: a computation cannot get lost; only messages can")
    if given.get("scheduling", SCHEDULINGS[0]) not in SCHEDULINGS:
        raise SetupError(f"{place}: scheduling: it is one of {', '.join(SCHEDULINGS)}")
    made.scheduling = given.get("scheduling", node.scheduling)
    made.advance = given.get("advance", node.advance)
    if "phase" in given:
        phase = None if given["phase"] is None else exact_number(f"{place}: phase", given["phase"])
        if phase is not None and phase < 0:
            raise SetupError(f"{place}: phase: {phase} s is below 0")
        made.phase = None if phase is None else exact_fraction(phase)
    return made


def _connection(
    graph: Graph, connection: Connection, given: Mapping[str, Any], nodes: Mapping[str, Node]
) -> Connection:
    ends = connection.sender, connection.receiver
    made = replace(connection, **given)
    wide = wide_enough(made, *(nodes[name] for name in ends))
    if "window" not in given or wide == made:
        return wide
    # A graph may have been made with less than its receivers need: then less stays, as long as they need no more.
    same = wide_enough(replace(connection, window=1), *map(graph.node, ends)).window == wide.window
    if same and made.window >= connection.window:
        return made
    raise SetupError(
        f"connections: {made.key}: window: {made.window} messages are too few, {made.receiver} needs {wide.window} "
        "with these rates and delays; write that, or leave the window out"
    )


def _filled(place: str, own: Any, value: Any) -> Any:
    like = torch.as_tensor(own)
    try:
        numbers = torch.as_tensor(value, dtype=torch.float64)
    except (ValueError, TypeError, OverflowError, RuntimeError) as error:
        raise SetupError(f"{place}: {shown(value)} is no array of numbers") from error
    if numbers.ndim and numbers.shape != like.shape:
        raise SetupError(f"{place}: it has the shape {tuple(like.shape)}; {tuple(numbers.shape)} is given")
    kind = like.dtype
    if not kind.is_floating_point and not bool((numbers.to(kind) == numbers).all()):
        if kind == torch.bool or isinstance(own, Tensor):
            raise SetupError(
                f"{place}: {shown(value)} does not fit its type, {str(kind).removeprefix('torch.')}"
            )
        kind = torch.float64  # whoever writes 1 for a mass may be given 1.3
    filled = numbers.to(kind).expand(like.shape).clone()
    return filled.item() if isinstance(own, bool | int | float) else filled


def _named(place: str, given: Iterable[str], known: Iterable[str]) -> None:
    known = list(known)
    for name in given:
        if name not in known:
            hint = did_you_mean(name, known) or f"; known: {', '.join(known)}"
            raise SetupError(f'{place}: there is no "{name}"{hint}')

"""Initial states: the nodes of a batch of environments before anything has run."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.execution.state import Generators, NodeParameters, RuntimeState
from deepkoco.graph.model.calls import call_init, call_initial_output
from deepkoco.graph.model.contract import check_batch
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Node, State


@dataclass(frozen=True)
class EpisodeSetup:
    """What episodes begin with.

    Attributes:
        schedule: when what runs.
        row: (B,) int64, schedule row of each environment.
        parameters: by node name, scalars or (B, ...).
        generator: passed to each node's `init`; or one for each environment.
        initial: by node name, states or parts of states (B, ...) that replace those of `init`.
    """

    schedule: Schedule
    row: np.ndarray
    parameters: NodeParameters
    generator: Generators
    initial: Mapping[str, State]


def initial_state(graph: Graph, setup: EpisodeSetup) -> RuntimeState:
    """The state before anything has run.

    Raises:
        ValueError: names or shapes do not fit.
        GraphError: a parameter is no tensor, or not one for each environment.
    """
    schedule, row, parameters = setup.schedule, setup.row, setup.parameters
    batch, known = len(row), schedule.rows
    if batch and not (row.min() >= 0 and row.max() < known):
        raise ValueError(f"rows {row.min()} to {row.max()}: there are schedules 0 to {known - 1}")
    graph.check_nodes((*parameters, *setup.initial))
    for name, given in parameters.items():
        for key, value in given.items():
            if not hasattr(value, "ndim"):
                raise GraphError(
                    f'parameter "{name}.{key}" = {value!r} is no tensor; give '
                    f"torch.tensor({value!r}, dtype=torch.float64)"
                )
            if value.ndim and len(value) not in (1, batch):
                raise GraphError(
                    f'parameter "{name}.{key}" {tuple(value.shape)} is neither a number nor one for each '
                    f"of {batch} environments"
                )
    nodes, outputs, values = {}, {}, {}
    for position, node in enumerate(graph.nodes):
        values[node.name] = dict(parameters.get(node.name, {}))
        node_state = _initial_node_state(node, values[node.name], setup.generator, batch)
        for key, value in setup.initial.get(node.name, {}).items():
            if key not in node_state or value.shape != node_state[key].shape:
                there = {k: tuple(v.shape) for k, v in node_state.items()}
                raise ValueError(f'initial "{node.name}.{key}" {tuple(value.shape)} does not fit {there}')
            node_state[key] = value
        nodes[node.name] = node_state
        output = call_initial_output(node, values[node.name], node_state, batch)
        check_batch(f'node "{node.name}": initial output', output, batch)
        for key, value in node_state.items():
            check_batch(f'node "{node.name}": initial state "{key}"', value, batch)
        outputs[node.name] = (output,) * int(schedule.depth[position])
    return RuntimeState(schedule, row, np.zeros(batch, dtype=np.int64), values, nodes, outputs, {})


def _initial_node_state(
    node: Node, parameters: Mapping[str, Tensor], generator: Generators, batch: int
) -> dict[str, Tensor]:
    """What `init` returns, (B, ...); with a generator for each environment, it draws for one after the other."""
    if isinstance(generator, torch.Generator):
        return call_init(node, parameters, generator, batch)
    each = []
    for place, own in enumerate(generator):
        values = {k: v[place : place + 1] if v.ndim and len(v) > 1 else v for k, v in parameters.items()}
        each.append(call_init(node, values, own, 1))
    return {key: torch.cat([state[key] for state in each]) for key in each[0]}

"""The start of an episode whose nodes live in threads and processes of their own."""

import math
import time
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.state import NodeParameters
from deepkoco.graph.live.crew import Crew
from deepkoco.graph.live.runner import InitialStateError, Runner
from deepkoco.graph.live.seat import reset_runner
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import State

HEAD_START = 10_000_000  # from the order to go to time 0 [ns]
FAR_HEAD_START = 100_000_000  # more of it where the order goes over a network [ns]


def reset_nodes(
    crew: Crew,
    supervisor: Runner,
    episode: int,
    parameters: NodeParameters,
    generator: torch.Generator,
    initial: Mapping[str, State],
) -> dict[str, np.ndarray]:
    """Reset every node, wherever it lives.

    Args:
        crew: the nodes.
        supervisor: runs the supervisor, in the caller's thread.
        episode: its number.
        parameters: by node name, scalars or (1, ...).
        generator: passed to each node's `init`; it is left as the last one left it.
        initial: by node name, states or parts of states (1, ...) that replace those of `init`.

    Returns:
        By node name, the initial output (1, ...).

    Raises:
        InitialStateError: `initial` does not fit a node's state.
        NodeFailure: a node has failed.
    """
    outputs: dict[str, np.ndarray] = {}
    # One after the other, so that the draws of `init` are those of a single process.
    for node in crew.graph.nodes:
        payload = {
            "episode": episode,
            "generator": generator.get_state().numpy(),
            "parameters": _arrays(parameters.get(node.name, {})),
            "initial": _arrays(initial.get(node.name, {})),
        }
        if node.name == crew.graph.supervisor:
            crew.supervisor_inbox.begin(episode)
            answer = reset_runner(supervisor, payload)
        else:
            answer = crew.ask({node.name: ("reset", payload)})[node.name]
        if "error" in answer:
            raise InitialStateError(answer["error"])
        outputs[node.name] = answer["output"]
        generator.set_state(torch.from_numpy(answer["generator"].copy()))
    return outputs


def received_outputs(graph: Graph, outputs: Mapping[str, np.ndarray]) -> dict[str, list[np.ndarray]]:
    """By node name, the initial outputs of its senders, one per input."""
    return {node.name: [outputs[c.sender] for c in graph.inputs_of(node.name)] for node in graph.nodes}


def start_instant(factor: float, more: int = 0) -> int:
    """Time 0 of an episode on the monotonic clock [ns]; at once where time is not that of the clock.

    Args:
        factor: simulated seconds per second.
        more: head start beyond the usual one [ns].
    """
    return time.monotonic_ns() + (0 if factor == math.inf else HEAD_START + more)


def _arrays(tensors: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
    return {key: np.array(value.detach().cpu().numpy()) for key, value in tensors.items()}

"""A function of one node as a kernel: what the tests of single operations run."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import BatchedRuntime, Connection, Graph, Node, Supervisor, draw_timing


class Apply(Node):
    """Holds an input in its state, which never changes, and puts out a function of it."""

    def __init__(self, function: Callable[[Tensor], Tensor], values: Tensor) -> None:
        super().__init__("apply", 10)
        self.function, self.values = function, values

    def init(self, parameters, generator, batch):
        return {"x": self.values}

    def initial_output(self, parameters, state, batch):
        return torch.zeros_like(self.function(self.values))

    def step(self, parameters, state, inputs):
        return state, self.function(state["x"])


def run(function: Callable[[Tensor], Tensor], values: Tensor, executor: str = "fused") -> Tensor:
    """Function of (B, ...) values as the executor works it out."""
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    graph = Graph([Apply(function, values), agent], [Connection("apply", "agent")])
    timing = draw_timing(graph, np.random.default_rng(0), 1, len(values))
    runtime = BatchedRuntime(graph, timing, executor=executor)
    _, inputs = runtime.reset({}, torch.Generator())
    assert runtime.executor == executor
    return inputs["apply"].data[:, 0]

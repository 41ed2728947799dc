"""The parameter INPUT.extra_delay moves the arrivals that a node reads, and nothing else."""

import numpy as np
import pytest
import torch

from deepkoco.graph import BatchedRuntime, Connection, Graph, Node, StepError, Supervisor, draw_timing
from deepkoco.graph.model.node import GraphError


class Arrivals(Node):
    """Puts out when its last two messages arrived."""

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 2, dtype=torch.float64)

    def step(self, parameters, state, inputs):
        return state, inputs["agent"].t_received.nan_to_num(neginf=-1.0)


def last_arrivals(executor: str, parameters: dict[str, torch.Tensor]) -> torch.Tensor:
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    graph = Graph(
        [Arrivals("plant", 10), agent],
        [Connection("agent", "plant", 0.03, window=2, skip=True), Connection("plant", "agent")],
    )
    timing = draw_timing(graph, np.random.default_rng(0), 5, 3)
    runtime = BatchedRuntime(graph, timing, executor=executor)
    state, _ = runtime.reset({"plant": parameters}, torch.Generator())
    for _ in range(5):
        state, inputs = runtime.step(state, torch.zeros(3, 1))
    return inputs["plant"].data[:, 0]


@pytest.mark.parametrize("executor", ["eager", "fused"])
def test_arrivals_are_later_in_each_environment(executor):
    # At 0.5 s the commands of 0.3 and 0.4 s have arrived.
    torch.testing.assert_close(
        last_arrivals(executor, {})[0], torch.tensor([0.33, 0.43], dtype=torch.float64)
    )
    delay = torch.tensor([0.0, 0.01, 0.02], dtype=torch.float64)
    moved = last_arrivals(executor, {"agent.extra_delay": delay}) - last_arrivals(executor, {})
    torch.testing.assert_close(moved, delay[:, None].expand(3, 2))


def test_a_delay_of_no_input_is_an_error():
    with pytest.raises(
        (GraphError, StepError), match=r'"agnet.extra_delay": no input "agnet"; there are agent'
    ):
        last_arrivals("eager", {"agnet.extra_delay": torch.tensor(0.1)})

"""A graph to count on: each tick the world adds stride * action; the episode ends at 5."""

import torch
from gymnasium import spaces

from deepkoco.graph import Connection, Graph, Node, Supervisor

ACTIONS = spaces.Box(-1.0, 1.0, (1,))
OBSERVATIONS = spaces.Box(-100.0, 100.0, (2,))


class Counter(Node):
    inputs = ("agent",)

    def init(self, parameters, generator, batch):
        return {"x": torch.zeros(batch, dtype=torch.float64), "begun": torch.zeros(batch, dtype=torch.bool)}

    def initial_output(self, parameters, state, batch):
        return state["x"][:, None]

    def step(self, parameters, state, inputs):
        # The first tick is at the agent's first step, before any action.
        action = inputs["agent"].data[:, -1, 0]
        x = torch.where(state["begun"], state["x"] + parameters["stride"] * action, state["x"])
        return {"x": x, "begun": torch.ones_like(state["begun"])}, x[:, None]


class CountingAgent(Supervisor):
    """Sees the count and the one before; is paid the count before times the action."""

    def __init__(self):
        super().__init__(rate=10, initial_action=torch.zeros(1, dtype=torch.float64))

    def init(self, parameters, generator, batch):
        return {"before": torch.zeros(batch, dtype=torch.float64)}

    def observe(self, parameters, state, inputs, action):
        now = inputs["counter"].data[:, -1, 0]
        readings = {
            "observation": torch.stack([now, state["before"]], -1),
            "reward": state["before"] * action[:, 0],
            "terminated": now >= 5.0,
            "count": now,
        }
        return {"before": now}, readings


def counting_graph(delay=0.0) -> Graph:
    nodes = [Counter("counter", 10), CountingAgent()]
    return Graph(
        nodes, [Connection("agent", "counter", delay=delay, skip=True), Connection("counter", "agent")]
    )

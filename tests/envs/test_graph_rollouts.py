"""Costs of action sequences on a graph: by hand on a body that drifts, with delays and without, with a past."""

import numpy as np
import pytest
import torch

from deepkoco.envs.graph_rollouts import GraphRollouts
from deepkoco.graph import Connection, Graph, Node, Supervisor


class Body(Node):
    """Its place moves on by the newest command, once a second; tick 0 puts out the start."""

    inputs = ("agent",)

    def init(self, parameters, generator, batch):
        return {
            "x": torch.zeros(batch, 1, dtype=torch.float64),
            "begun": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters, state, batch):
        return state["x"]

    def step(self, parameters, state, inputs):
        moved = state["x"] + inputs["agent"].data[:, -1]
        x = torch.where(state["begun"][:, None], moved, state["x"])
        return {"x": x, "begun": torch.ones_like(state["begun"])}, x


class Seat(Supervisor):
    """Pays for the place."""

    inputs = ("body",)

    def observe(self, parameters, state, inputs, action):
        x = inputs["body"].data[:, -1, 0]
        return state, {"observation": x[:, None], "reward": -x}


def graph(delay: float) -> Graph:
    return Graph(
        [
            Body("body", 1, phase=0),
            Seat("agent", 1, initial_action=torch.zeros(1, dtype=torch.float64), phase=0),
        ],
        [Connection("body", "agent"), Connection("agent", "body", delay=delay, skip=True)],
    )


START = {"body": {"x": torch.tensor([[1.0], [10.0]], dtype=torch.float64)}}
PLANS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 5.0]])[None, :, :, None].repeat(2, 0)
NO_PAST = np.zeros((2, 0, 1))


def test_without_delay_an_action_acts_until_the_next_step():
    """From x: after actions 1, 0, 0 it is x + 1 three times; after 0, 0, 5 it is x, x, x + 5."""
    costs = GraphRollouts(graph(0.0), 3).costs(START, NO_PAST, PLANS)
    np.testing.assert_allclose(costs, [[6.0, 8.0], [33.0, 35.0]])


def test_with_a_delay_it_acts_later():
    """1.5 s: the command of 0 s acts from the tick at 2 s on."""
    costs = GraphRollouts(graph(1.5), 3).costs(START, NO_PAST, PLANS)
    np.testing.assert_allclose(costs, [[3.0 + 2.0, 3.0], [30.0 + 2.0, 30.0]])


def test_delays_can_be_left_out_of_a_graph_that_has_them():
    costs = GraphRollouts(graph(1.5), 3, delays=False).costs(START, NO_PAST, PLANS)
    np.testing.assert_allclose(costs, [[6.0, 8.0], [33.0, 35.0]])


def test_the_past_acts_and_is_not_paid_for():
    """2 was taken at 0 s, the plans begin at 1 s and are paid for at 2, 3 and 4 s.

    With the delay, 2 acts at 2 s, the 1 of the first plan at 3 s. Without, 2 has acted at 1 s, the 1 acts at 2 s.
    """
    past = np.array([[[2.0]], [[0.0]]])
    late = GraphRollouts(graph(1.5), 4).costs(START, past, PLANS)
    np.testing.assert_allclose(late[0], [3.0 + 4.0 + 4.0, 9.0])
    soon = GraphRollouts(graph(0.0), 4).costs(START, past, PLANS)
    np.testing.assert_allclose(soon[0], [12.0, 9.0 + 5.0])


def test_rollouts_longer_than_planned_are_refused():
    with pytest.raises(ValueError, match="made for 3"):
        GraphRollouts(graph(0.0), 3).costs(START, np.zeros((2, 1, 1)), PLANS)

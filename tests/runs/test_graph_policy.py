"""A policy in a graph bridges the graph's delays by its time stamps, in simulated and in wall-clock time."""

import numpy as np
import pytest
import torch

from deepkoco.agent.delayed_policy import DelayedPolicy
from deepkoco.agent.policy import KoopmanPolicy
from deepkoco.graph import Connection, Graph, Node, Supervisor, draw_timing
from deepkoco.graph.live import SimulatedRuntime, WallClockRuntime
from deepkoco.koopman.lifting import Identity
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, target_cost
from deepkoco.planning import PlannerConfig
from deepkoco.runs.graph_policy import GraphPolicy

STEP, WORLD = 0.1, 0.005  # [s]
START = (1.0, -0.2)


class World(Node):
    """A mass on which a force acts: position and velocity, exact over a held force."""

    inputs = ("agent",)

    def init(self, parameters, generator, batch):
        return {"x": torch.tensor([START], dtype=torch.float64).repeat(batch, 1)}

    def initial_output(self, parameters, state, batch):
        return state["x"]

    def step(self, parameters, state, inputs):
        # The state is sent before it moves: what a message holds is the state at its time.
        x, force = state["x"], inputs["agent"].data[:, -1]
        moved = torch.cat((x[:, :1] + WORLD * x[:, 1:] + 0.5 * WORLD**2 * force, x[:, 1:] + WORLD * force), 1)
        return {"x": moved}, x


def make_graph(sensing, actuation, fifo=True):
    agent = Supervisor(rate=1 / STEP, initial_action=torch.zeros(1, dtype=torch.float64), phase=0)
    return Graph(
        [World("world", 1 / WORLD, phase=0), agent],
        [
            Connection("world", "agent", name="sensor", delay=sensing, window=3, fifo=fifo),
            Connection("agent", "world", delay=actuation, skip=True, fifo=fifo),
        ],
    )


@pytest.fixture(scope="module")
def settings():
    cost = target_cost(np.eye(2), np.array([1.0, 0.1]), np.zeros(2), 0.01)
    model = LiftedLinearModel(
        Identity(2), np.array([[1.0, STEP], [0.0, 1.0]]), np.array([[0.5 * STEP**2], [STEP]]), cost, STEP
    )
    return model, PlannerConfig(horizon=15), -np.ones(1), np.ones(1)


def positions(episode):
    return episode.outputs["world"][:, 0]


def simulated(graph, policy, steps=60):
    timing = draw_timing(graph, np.random.default_rng(0), steps, 1)
    with SimulatedRuntime(graph, timing) as runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        policy.reset()
        runtime.run(policy, steps)
        return np.asarray(positions(runtime.finish()))


def spent(path):
    """Integral of the squared position over the episode."""
    return float(np.square(path).sum() * WORLD)


@pytest.mark.parametrize("fifo", [True, False])
def test_random_delays_of_a_graph_cost_little_when_its_stamps_are_used(settings, fifo):
    best = spent(simulated(make_graph(0.0, 0.0), GraphPolicy(DelayedPolicy(*settings))))
    law = {"law": "uniform", "low": 0.0, "high": 0.4}
    graph = make_graph(law, 0.25, fifo)
    told = spent(simulated(graph, GraphPolicy(DelayedPolicy(*settings, actuation_delay=0.25))))

    class Ignorant(GraphPolicy):
        def __init__(self):
            self.policy = KoopmanPolicy(*settings)

        def reset(self):
            self.policy.reset()

        def __call__(self, inputs):
            seen = inputs["sensor"]
            return torch.from_numpy(self.policy.act(seen.data[0, int(seen.seq[0].argmax())]).astype(float))[
                None
            ]

    assert told < 1.5 * best
    assert spent(simulated(graph, Ignorant())) > 2.0 * best


def test_without_delays_a_graph_is_the_loop_of_the_plain_policy(settings):
    path = simulated(make_graph(0.0, 0.0), GraphPolicy(DelayedPolicy(*settings)), 30)
    policy, x, expected = KoopmanPolicy(*settings), np.array(START), []
    for _ in range(30):
        expected.append(x[0])
        force = policy.act(x).item()
        x = np.array([x[0] + STEP * x[1] + 0.5 * STEP**2 * force, x[1] + STEP * force])
    # An action acts from the next tick of the world on, 5 ms late, at up to 1 m/s.
    np.testing.assert_allclose(path[:: round(STEP / WORLD)][: len(expected)], expected, atol=0.006)


def test_it_runs_in_wall_clock_time(settings):
    graph = make_graph(0.02, 0.05)
    policy = GraphPolicy(DelayedPolicy(*settings, actuation_delay=0.05))
    with WallClockRuntime(graph) as runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(policy, 20)
        path = np.asarray(positions(runtime.finish()))
    # 2 s from a position of 1 m with at most 1 m/s2, on a machine that may be busy.
    assert abs(path[-1]) < 0.9
    assert policy._policy.statistics.failures == 0

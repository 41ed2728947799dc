"""fit_graph and trainable delays on an episode of a graph."""

import numpy as np
import pytest
import torch

from deepkoco.fit import FitError
from deepkoco.fit.delays.trainable_delay import held, interpolated
from deepkoco.fit.graph_fit import fit_graph, seen_by_supervisor
from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Graph,
    Input,
    Node,
    Supervisor,
    draw_timing,
    record_episodes,
)

F64 = torch.float64
LOW, HIGH = 0.0, 0.1
TRUE = {"mass": 1.3, "late": 0.37}


class Sled(Node):
    """A mass on a rail whose motor responds after a hidden delay."""

    inputs = ("agent",)

    def init(self, parameters, generator, batch):
        return {"x": torch.zeros(batch, 2, dtype=F64)}

    def initial_output(self, parameters, state, batch):
        return state["x"]

    def step(self, parameters, state, inputs):
        force = held(inputs["agent"], parameters["late"], LOW, HIGH)[:, 0]
        position, speed = state["x"].unbind(-1)
        speed = speed + 0.005 * (force - 0.4 * speed) / parameters["mass"]
        x = torch.stack([position + 0.005 * speed, speed], -1)
        return {"x": x}, x


class Watcher(Supervisor):
    inputs = ("sled",)

    def observe(self, parameters, state, inputs, action):
        newest = inputs["sled"].data[:, -1]
        return state, {"observation": newest, "position": newest[:, 0]}


def make() -> Graph:
    start = torch.zeros(1, dtype=F64)
    return Graph(
        [Sled("sled", rate=200, delay=0.001), Watcher("agent", rate=20, initial_action=start)],
        [
            Connection("sled", "agent", delay={"law": "gaussian", "loc": 0.01, "scale": 0.002}),
            Connection("agent", "sled", delay=0.004, window=6, skip=True),
        ],
    )


@pytest.fixture(scope="module")
def unit():
    graph = make()
    timing = draw_timing(graph, np.random.default_rng(0), steps=120, batch=1)
    parameters = {"sled": {k: torch.tensor(v, dtype=F64) for k, v in TRUE.items()}}
    force = torch.Generator().manual_seed(1)
    runtime = BatchedRuntime(graph, timing)
    episodes, _ = record_episodes(
        runtime, lambda _: torch.randn(1, 1, generator=force, dtype=F64), parameters, force
    )
    return graph, episodes[0]


def test_fit_graph_recovers_mass_and_trainable_delay(unit):
    graph, episode = unit
    seen = seen_by_supervisor(graph, episode, "sled->agent")
    sd = 1e-3
    measured = {"observation": seen + sd * np.random.default_rng(3).standard_normal(seen.shape)}
    parameters = {"sled": {"mass": torch.tensor(1.0, dtype=F64), "late": torch.tensor(0.5, dtype=F64)}}
    result = fit_graph(
        graph,
        episode,
        parameters,
        {"sled.mass": (0.5, 3.0), "sled.late": (0.0, 1.0)},
        measured,
        {"observation": sd},
        population=32,
        generations=40,
    )
    assert result.estimates["sled.mass"].value == pytest.approx(TRUE["mass"], rel=0.02)
    delay = LOW + result.estimates["sled.late"].value * (HIGH - LOW)
    # The node runs every 5 ms and uses a message at its next step, so the delay is identified to 5 ms.
    assert delay == pytest.approx(LOW + TRUE["late"] * (HIGH - LOW), abs=0.005)
    assert result.rms["observation"] == pytest.approx(sd, rel=0.1)
    assert result.convergence.stages[0][1][-1] < result.convergence.stages[0][1][0]


def test_a_reading_may_be_one_number(unit):
    graph, episode = unit
    position = seen_by_supervisor(graph, episode, "sled->agent")[:, 0]
    sought, true = {"sled.mass": (0.5, 3.0)}, {"sled": {"late": torch.tensor(TRUE["late"], dtype=F64)}}
    result = fit_graph(
        graph, episode, true, sought, {"position": position}, {"position": 1e-3}, population=16
    )
    assert result.estimates["sled.mass"].value == pytest.approx(TRUE["mass"], rel=1e-3)


@pytest.mark.parametrize(
    ("sought", "message"),
    [
        ({}, "no parameter to fit"),
        ({"mass": (0.0, 1.0)}, "is not of the form node.parameter"),
        ({"cart.mass": (0.0, 1.0)}, "the nodes are agent, sled"),
        ({"sled.mass": (2.0, 1.0)}, "give two finite numbers, the lower one first"),
    ],
)
def test_fit_graph_refuses_wrong_requests(unit, sought, message):
    graph, episode = unit
    with pytest.raises(FitError, match=message):
        fit_graph(graph, episode, {}, sought, {}, {})


def messages(times, values) -> Input:
    t = torch.tensor([times], dtype=F64)
    data = torch.tensor([values], dtype=F64)[..., None]
    return Input(data, torch.arange(len(times))[None], t, t, torch.tensor([1.0], dtype=F64))


@pytest.mark.parametrize(("alpha", "expected"), [(0.0, 4.0), (0.5, 2.0), (0.55, 1.0), (1.0, 1.0)])
def test_held_returns_the_newest_arrived_message(alpha, expected):
    # At t = 1 the delays are 0, 0.4, 0.44 and 0.8 s: instants 1.0, 0.6, 0.56 and 0.2.
    seen = messages([0.1, 0.6, 0.9], [1.0, 2.0, 4.0])
    assert held(seen, torch.tensor(alpha, dtype=F64), 0.0, 0.8).item() == expected


def test_interpolated_is_linear_between_messages_and_differentiable():
    seen = messages([-np.inf, 0.5, 0.9], [7.0, 1.0, 3.0])
    alpha = torch.tensor(0.3, dtype=F64, requires_grad=True)
    value = interpolated(seen, alpha, 0.0, 1.0)  # at 0.7: half way from 1 to 3
    assert value.item() == pytest.approx(2.0)
    value.sum().backward()
    assert alpha.grad is not None
    assert alpha.grad.item() == pytest.approx(-5.0)  # 2 per 0.4 s, backwards
    assert interpolated(seen, torch.tensor(0.8, dtype=F64), 0.0, 1.0).item() == 7.0

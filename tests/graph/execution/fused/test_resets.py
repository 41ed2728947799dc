"""Environments that start anew at any time, on any schedule, with nodes that read every field of their inputs."""

from fractions import Fraction

import numpy as np
import pytest
import torch

from deepkoco.graph import BatchedRuntime, Connection, Gaussian, Graph, Node, Supervisor, draw_timing

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


class Clocked(Node):
    """Adds up the ages, numbers and times of its messages."""

    def init(self, parameters, generator, batch):
        return {
            "sum": torch.zeros(batch, 2, dtype=torch.float64),
            "steps": torch.zeros(batch, dtype=torch.int64),
            "odd": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 2, dtype=torch.float64)

    def step(self, parameters, state, inputs):
        total = torch.where(state["odd"][:, None], 0.5, 0.25) * state["sum"]
        for name in sorted(inputs):
            seen = inputs[name]
            age = (seen.t_start[:, None] - seen.t_received).clamp(max=3.0).sum(1)
            sent = torch.where(torch.isinf(seen.t_sent), 0.0, seen.t_sent).sum(1)
            number = seen.seq.double().mean(1) + (seen.seq >= 0).sum(1)
            total = total + torch.stack([age, sent + 0.1 * number], 1) + 0.01 * seen.data.sum(1)
        return {"sum": total, "steps": state["steps"] + 1, "odd": ~state["odd"]}, total


class Reader(Supervisor):
    """Reads the age of its newest message and the sum of its own actions."""

    def init(self, parameters, generator, batch):
        return {"given": torch.zeros(batch, dtype=torch.float64)}

    def observe(self, parameters, state, inputs, action):
        seen = inputs["slow"]
        given = state["given"] + action[:, 0]
        age = seen.t_start - seen.t_received[:, -1].clamp(min=-1.0)
        return {"given": given}, {"level": seen.data[:, -1].sum(1) + given, "age": age}


def make_graph() -> Graph:
    action = torch.zeros(2, dtype=torch.float64)
    return Graph(
        [Clocked("fast", 50), Clocked("slow", Fraction(100, 3)), Reader("agent", 20, initial_action=action)],
        [
            Connection("fast", "slow", Gaussian(0.02, 0.02), window=3),
            Connection("slow", "agent", Gaussian(0.03, 0.02), window=2),
            Connection("agent", "fast", Gaussian(0.01, 0.03), window=2, skip=True),
            Connection("slow", "fast", Gaussian(0.05, 0.05), skip=True, fifo=False),
        ],
    )


def test_environments_on_different_steps_of_different_schedules_agree_with_the_eager_executor():
    graph, steps, batch = make_graph(), 20, 29
    timing = draw_timing(graph, np.random.default_rng(0), steps, 50, rows=50)
    runtimes = [BatchedRuntime(graph, timing, executor=name) for name in ("fused", "eager")]
    draws = np.random.default_rng(5)
    rows = draws.integers(50, size=batch)
    states = [runtime.reset({}, torch.Generator(), rows=rows)[0] for runtime in runtimes]
    for _ in range(2 * steps):
        mask = (draws.random(batch) < 0.05) | (states[1].steps_left <= 0)
        if mask.any():
            rows = draws.integers(50, size=batch)
            states = [
                runtime.reset({}, torch.Generator(), rows=rows, state=state, mask=mask)[0]
                for runtime, state in zip(runtimes, states, strict=True)
            ]
        action = torch.from_numpy(draws.normal(size=(batch, 2)))
        (fused, seen), (eager, expected) = (
            runtime.step(state, action) for runtime, state in zip(runtimes, states, strict=True)
        )
        np.testing.assert_array_equal(fused.step, eager.step)
        for name, value in eager.readings.items():
            torch.testing.assert_close(fused.readings[name], value, rtol=1e-12, atol=1e-12)
        for part, value in zip(seen["slow"], expected["slow"], strict=True):
            torch.testing.assert_close(part, value, rtol=1e-12, atol=1e-12)
        states = [fused, eager]
    assert len(set(states[1].step.tolist())) > 5
    for key, value in states[1].nodes["fast"].items():
        torch.testing.assert_close(states[0].nodes["fast"][key], value, rtol=1e-12, atol=1e-12)

"""Nodes that ask for their period and for noise, in a module of their own so that they travel to processes."""

import torch

from deepkoco.graph import Connection, Gaussian, Graph, Node, Supervisor


class Drifting(Node):
    """Integrates its last command over its period; a random walk and the measurement noise lie on top."""

    inputs = ("agent",)

    def init(self, parameters, generator, batch):
        return {"x": torch.rand(batch, 2, generator=generator, dtype=torch.float64)}

    def initial_output(self, parameters, state, batch):
        assert list(state) == ["x"]
        return state["x"]

    def step(self, parameters, state, inputs, *, dt, noise):
        assert list(state) == ["x"]
        x = state["x"] + dt * inputs["agent"].data[:, -1] + dt**0.5 * noise.normal(2)
        return {"x": x}, x + 0.1 * noise.normal()[:, None] + 0.01 * noise.uniform(2)


class Noisy(Node):
    """Puts out its noise: a number, and a picture's worth."""

    inputs = ()

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 42, dtype=torch.float64)

    def step(self, parameters, state, inputs, *, noise):
        return state, torch.cat([noise.normal(1), noise.normal(8, 5).flatten(1), noise.uniform(1)], 1)


class Watcher(Supervisor):
    """Reads what it sees with noise of its own, and its own period."""

    def observe(self, parameters, state, inputs, action, *, noise, dt):
        seen = inputs["world"].data[:, -1]
        return state, {"observation": seen + noise.normal(2), "dt": torch.full_like(seen[:, 0], dt)}


def noisy_graph() -> Graph:
    agent = Watcher("agent", 20, initial_action=torch.zeros(2, dtype=torch.float64))
    return Graph(
        [Drifting("world", 50), Noisy("noisy", 30), agent],
        [
            Connection("world", "agent", Gaussian(0.02, 0.01)),
            Connection("noisy", "agent", window=2),
            Connection("agent", "world", Gaussian(0.02, 0.01), skip=True),
        ],
    )


def act(inputs) -> torch.Tensor:
    return -0.5 * inputs["world"].data[:, -1]

"""The work of the rollout benchmark: a disk pendulum with random delays and a neural policy, in float32.

World at 100 Hz (one Runge-Kutta step per tick), sensor, actuator and agent at 50 Hz; the agent sees the last
two measurements and acts through two layers of 64 tanh units. `peers/rex_rollout.py` is the same
work for the peer.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from deepkoco.graph import Connection, Gaussian, Graph, Input, Node, Supervisor
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems import rk4_step
from deepkoco.systems.bodies.pendulum import Pendulum

WORLD_RATE, AGENT_RATE = 100, 50
SENSING, ACTUATION = Gaussian(0.012, 0.003), Gaussian(0.008, 0.002)  # [s]
WINDOW = 2
UNITS = 64
SPEED_LIMIT = 40.0  # [rad/s]


class PendulumWorld(Node):
    """Integrates the pendulum by one Runge-Kutta step a tick; the output (B, 2) is angle and speed."""

    inputs = ("actuator",)

    def __init__(self) -> None:
        super().__init__("world", WORLD_RATE)
        self.system = Pendulum()

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        angle = 2 * torch.pi * torch.rand(batch, 1, generator=generator) - torch.pi
        return {"state": torch.cat([angle, torch.zeros_like(angle)], 1)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["state"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        effort = inputs["actuator"].data[:, -1, 0]
        after = rk4_step(self.system, state["state"], effort, 1 / WORLD_RATE, parameters)
        after = torch.stack([after[:, 0], after[:, 1].clamp(-SPEED_LIMIT, SPEED_LIMIT)], 1)
        return {"state": after}, after


class Relay(Node):
    """Passes the last message on: a sensor or an actuator without faults."""

    def __init__(self, name: str, size: int) -> None:
        super().__init__(name, AGENT_RATE)
        self.size = size

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, self.size)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        (seen,) = inputs.values()
        return state, seen.data[:, -1]


class PendulumAgent(Supervisor):
    """Observes cosine, sine and speed of the last measurements, oldest first."""

    inputs = ("sensor",)

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        angle, speed = inputs["sensor"].data.unbind(-1)
        return state, {"observation": torch.stack([torch.cos(angle), torch.sin(angle), speed], -1).flatten(1)}


def make_graph(delays: bool = True) -> Graph:
    """World, sensor, actuator and agent with random delays, or without any."""
    sensing, actuation = (SENSING, ACTUATION) if delays else (0.0, 0.0)
    return Graph(
        [
            PendulumWorld(),
            Relay("sensor", 2),
            PendulumAgent("agent", AGENT_RATE, initial_action=torch.zeros(1)),
            Relay("actuator", 1),
        ],
        [
            Connection("world", "sensor"),
            Connection("sensor", "agent", sensing, window=WINDOW),
            Connection("agent", "actuator", actuation),
            Connection("actuator", "world", skip=True),
        ],
    )


def make_parameters() -> dict[str, dict[str, Tensor]]:
    """The pendulum's own parameters in float32."""
    values = Pendulum().default_parameters()
    return {"world": {name: value.to(torch.float32) for name, value in values.items()}}


def make_policy() -> nn.Sequential:
    """Two layers of tanh units with weights from a fixed seed."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return nn.Sequential(
            nn.Linear(3 * WINDOW, UNITS),
            nn.Tanh(),
            nn.Linear(UNITS, UNITS),
            nn.Tanh(),
            nn.Linear(UNITS, 1),
        )

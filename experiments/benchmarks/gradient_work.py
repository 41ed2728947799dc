"""The work of the gradient benchmark: graphs with random delays whose worlds are integrated by Runge-Kutta.

World at 100 Hz, sensor, actuator and agent at 50 Hz, in float32. The loss is the sum of squares of the world's last
state; its gradient is wanted by all parameters, the start and all actions.
"""

import math

import torch
from torch import Tensor

from deepkoco.graph import Connection, Graph, Input, Node, Supervisor
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems import System, make_system, rk4_step
from experiments.benchmarks.rollout_work import (
    ACTUATION,
    AGENT_RATE,
    SENSING,
    WORLD_RATE,
    PendulumWorld,
    Relay,
)

GRAVITY = 9.81  # [m/s2]


class ArmWorld(Node):
    """A planar arm of two links; the state (B, 4) is two angles and their speeds."""

    inputs = ("actuator",)
    width, size = 2, 4

    def __init__(self) -> None:
        super().__init__("world", WORLD_RATE)
        self.system: System = make_system("two_link_arm")

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"state": 0.5 * torch.randn(batch, self.size, generator=generator)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["state"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        effort = inputs["actuator"].data[:, -1]
        after = rk4_step(self.system, state["state"], effort, 1 / WORLD_RATE, parameters)
        return {"state": after}, after


class QuadrotorWorld(ArmWorld):
    """A quadrotor in space; commands are thrust [N], roll, pitch [rad] and yaw rate [rad/s].

    m v' = R(roll, pitch, yaw) e_3 f - m g e_3 - D v; attitude and thrust follow their commands with first-order lags.
    The state (B, 10) is position, velocity, roll, pitch, yaw and thrust.
    """

    width, size = 4, 10

    def __init__(self) -> None:
        Node.__init__(self, "world", WORLD_RATE)

    def derivative(self, x: Tensor, command: Tensor, p: Parameters) -> Tensor:
        *_, vx, vy, vz, roll, pitch, yaw, thrust = x.unbind(-1)
        lift, roll_wanted, pitch_wanted, yaw_rate = command.unbind(-1)
        push = thrust / p["mass"]
        sin_roll, cos_roll, sin_yaw, cos_yaw = roll.sin(), roll.cos(), yaw.sin(), yaw.cos()
        sin_pitch, cos_pitch = pitch.sin(), pitch.cos()
        side, up = p["drag"] / p["mass"], p["drag_up"] / p["mass"]
        rates = [
            push * (cos_roll * sin_pitch * cos_yaw + sin_roll * sin_yaw) - side * vx,
            push * (cos_roll * sin_pitch * sin_yaw - sin_roll * cos_yaw) - side * vy,
            push * cos_roll * cos_pitch - GRAVITY - up * vz,
            (p["roll_gain"] * roll_wanted - roll) / p["roll_lag"],
            (p["pitch_gain"] * pitch_wanted - pitch) / p["pitch_lag"],
            yaw_rate,
            (lift + GRAVITY * p["mass"] - thrust) / p["thrust_lag"],
        ]
        return torch.stack([vx, vy, vz, *rates], -1)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        command, x, h = inputs["actuator"].data[:, -1], state["state"], 1 / WORLD_RATE
        k1 = self.derivative(x, command, parameters)
        k2 = self.derivative(x + 0.5 * h * k1, command, parameters)
        k3 = self.derivative(x + 0.5 * h * k2, command, parameters)
        k4 = self.derivative(x + h * k3, command, parameters)
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return {"state": after}, after


QUADROTOR = {
    "mass": 0.033, "drag": 0.01, "drag_up": 0.015, "roll_gain": 1.0, "pitch_gain": 1.0, "roll_lag": 0.15,
    "pitch_lag": 0.15, "thrust_lag": 1 / 15.47,
}  # fmt: skip
WORLDS = ("pendulum", "arm", "quadrotor")


def make_world(name: str) -> tuple[Node, dict[str, Tensor], int, int]:
    """A world, its parameters, and the sizes of command and state."""
    if name == "quadrotor":
        world = QuadrotorWorld()
        values = {key: torch.tensor(value) for key, value in QUADROTOR.items()}
        return world, values, world.width, world.size
    world, width, size = (ArmWorld(), 2, 4) if name == "arm" else (PendulumWorld(), 1, 2)
    values = world.system.default_parameters()
    return world, {key: value.to(torch.float32) for key, value in values.items()}, width, size


def make_graph(world: Node, width: int, size: int) -> Graph:
    """World, sensor, actuator and agent with random delays."""
    return Graph(
        [
            world,
            Relay("sensor", size),
            Supervisor("agent", AGENT_RATE, initial_action=torch.zeros(width)),
            Relay("actuator", width),
        ],
        [
            Connection("world", "sensor"),
            Connection("sensor", "agent", SENSING, window=2),
            Connection("agent", "actuator", ACTUATION),
            Connection("actuator", "world", skip=True),
        ],
    )


def make_actions(steps: int, batch: int, width: int) -> Tensor:
    """Actions (steps, B, M) that shake the world without throwing it over."""
    time = torch.arange(steps)[:, None, None] / AGENT_RATE
    phase = torch.linspace(0, 2 * math.pi, batch)[:, None] + torch.arange(width)
    return 0.1 * torch.sin(2 * math.pi * 0.7 * time + phase)

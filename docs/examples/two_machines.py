"""A pendulum that is driven from another machine: `deepkoco serve` has world and sensor, `deepkoco lead` the policy."""

import torch

from deepkoco.engines import UnitEngine, make_graph
from deepkoco.graph import Graph
from deepkoco.systems import make_system
from deepkoco.unit import make_unit

RATE = 100.0  # Hz


def graph() -> Graph:
    """World, sensor and agent; the world is a unit that stops its motor by itself 0.1 s after the last command."""
    unit = make_unit("rod_pendulum", heartbeat=0.1)
    return make_graph(
        "rod_pendulum", UnitEngine(unit=unit, world_rate=RATE), control_rate=RATE, sensing_delay=0.002
    )


def parameters():
    """Both nodes of the robot start from a pendulum that hangs at 3 rad."""
    values = make_system("rod_pendulum").default_parameters() | {"start": torch.tensor([[3.0, 0.0]])}
    return {"world": values, "sensor": values}


def policy(inputs):
    """Add energy: a torque in the direction of the speed."""
    speed = inputs["sensor"].data[:, -1, 1:]
    return 0.5 * torch.tanh(3.0 * speed)

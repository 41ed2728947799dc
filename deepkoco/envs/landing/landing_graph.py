"""The graph of a landing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from deepkoco.engines.landing import Deck, DeckSensor, Flight, FlightSensor, MotorStop, Touchdown
from deepkoco.engines.landing.deck import NOISE, deck_pose, deck_start
from deepkoco.envs.landing.seat import FAR, HIGH, LandingSeat
from deepkoco.graph import Connection, Graph
from deepkoco.graph.delay import make_delay
from deepkoco.graph.model.connection import wide_enough
from deepkoco.graph.model.node import State
from deepkoco.systems import make_system
from deepkoco.systems.bodies.quadrotor import hover_thrust

WORLD_RATE, CONTROL_RATE = 100.0, 50.0
DECK_DELAY = 0.05
"""Of a measured deck: a camera's picture, or a radio [s]."""
SPEED_LIMIT = 5.0  # of the body, along each axis [m/s]
START = ((-0.7, 0.7), (-0.7, 0.7), (0.4, 1.0))
"""Where the body starts, from the centre of the deck along x, y and z [m]."""
START_SPEED = 0.5
"""Its speed at the start lies within this along each axis [m/s]."""


@dataclass(frozen=True)
class LandingOptions:
    """How body and deck are measured and controlled.

    Attributes:
        history: Past actions in the agent's observation.
        noise: Both sensors have noise.
        deck_rate: Ticks of the deck and of its sensor per second [Hz].
        sensing_delay: From the sensor of the body to the agent; the delays of its commands may include it instead.
        deck_delay: From the sensor of the deck to the agent.
        actuation_delay: From the motor stop to the body, beside the delays that the body's own commands have.
        longest_delay: Longest own delay of a command in any environment [s].
    """

    history: int = 10
    noise: bool = True
    deck_rate: float = WORLD_RATE
    sensing_delay: Any = 0.0
    deck_delay: Any = DECK_DELAY
    actuation_delay: Any = 0.0
    longest_delay: float = 0.034


def landing_graph(options: LandingOptions | None = None) -> Graph:
    """Body, deck, their sensors, the touch-down, the motor stop and the agent.

    Args:
        options: See there.

    Raises:
        ValueError: A delay or a rate is none.
    """
    options = options or LandingOptions()
    idle = hover_command()
    world, stop = (
        Flight(WORLD_RATE, SPEED_LIMIT, options.longest_delay),
        MotorStop(CONTROL_RATE, idle, FAR, HIGH),
    )
    nodes = [
        world,
        Deck(options.deck_rate),
        # At the rate of the world: with a delay that varies the agent sees the newest that has arrived.
        FlightSensor(WORLD_RATE, options.noise),
        DeckSensor(options.deck_rate, NOISE if options.noise else (0.0, 0.0, 0.0)),
        Touchdown(WORLD_RATE),
        stop,
        LandingSeat(CONTROL_RATE, idle, options.history),
    ]
    connections = [
        Connection("world", "sensor"),
        Connection("world", "touchdown"),
        Connection("deck", "touchdown"),
        Connection("deck", "deck_sensor"),
        Connection("sensor", "agent", delay=make_delay(options.sensing_delay)),
        Connection("deck_sensor", "agent", delay=make_delay(options.deck_delay)),
        Connection("touchdown", "agent"),
        Connection("touchdown", "motor_stop"),
        # Of this tick, also where messages take a while.
        Connection("agent", "motor_stop", blocking=True, name="command"),
        wide_enough(
            Connection(
                "motor_stop", "world", delay=make_delay(options.actuation_delay), skip=True, name="command"
            ),
            stop,
            world,
        ),
    ]
    return Graph(nodes, connections)


def hover_command() -> Tensor:
    """Thrust of the nominal hover [N], level: (3,)."""
    thrust = hover_thrust(make_system("quadrotor").default_parameters())
    return torch.tensor([thrust, 0.0, 0.0], dtype=torch.float64)


def landing_start(
    incline: Tensor,
    speed: Tensor,
    generator: torch.Generator,
    body: Tensor | None = None,
) -> dict[str, State]:
    """Start states by node: the deck at the origin, the body in the air near it, held by the thrust of the hover.

    Args:
        incline: (B,) of the deck [rad].
        speed: (B,) of the deck [m/s].
        generator: Of all draws.
        body: (B, 6) start of the body; None draws it.
    """
    batch = len(incline)
    deck = deck_start(incline, speed, generator)
    if body is None:
        unit = torch.rand(batch, 6, generator=generator, dtype=torch.float64)
        low, high = torch.tensor([*START, *((-START_SPEED, START_SPEED),) * 3], dtype=torch.float64).unbind(
            -1
        )
        body = low + (high - low) * unit
    pose = deck_pose(deck)
    return {
        "world": {"state": body, "effort": hover_command().expand(batch, 3).clone()},
        "sensor": {"start": body.clone()},
        "deck": deck,
        "deck_sensor": {"start": torch.cat([pose.place, pose.velocity, pose.normal], -1)},
    }

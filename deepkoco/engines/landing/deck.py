"""A deck that drives, and the sensor that follows it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.landing import DeckPose, deck_normal, deck_parameters, drive_on

VECTOR = ((3,), torch.float64)
POSE = {"place": VECTOR, "velocity": VECTOR, "normal": VECTOR, "turn": ((), torch.float64)}
SEEN = ("place", "velocity", "normal")
NOISE = (0.005, 0.02, 0.01)
"""Of a measured deck: place [m], velocity [m/s], and each component of the normal [1]."""


class Deck(Node):
    """Drives one tick at a time, see `deepkoco.systems.landing.moving_deck`; tick 0 puts out the start.

    Output: a `DeckPose` in parts.

    The start draws heading, slope and turn rate, the last as a multiple of its standard deviation. Incline and speed
    are zero unless the reset gives others, as `deck_start` makes them.

    Args:
        rate: Ticks per second [Hz].
    """

    outputs = POSE
    inputs = ()
    free_rate = True

    def __init__(self, rate: float) -> None:
        super().__init__("deck", rate)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        still = torch.zeros(batch, dtype=torch.float64)
        return {
            **deck_start(still, still, generator),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return deck_pose(state, parameters)._asdict()

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float, noise
    ) -> tuple[State, dict[str, Tensor]]:
        own = {**deck_parameters(), **parameters}
        names = ("x", "y", "heading", "swing")
        now = state["x"], state["y"], state["heading"], state["swing"]
        after = drive_on(now, state["speed"], dt, own, noise.normal())
        started = state["started"]
        kept = {n: torch.where(started, a, b) for n, a, b in zip(names, after, now, strict=True)}
        state = {**state, **kept, "started": torch.ones_like(started)}
        return state, deck_pose(state, own)._asdict()


class DeckSensor(Node):
    """Measures place, velocity and normal of the deck, as a camera or a radio does; the turn rate is not measured.

    Output: ``place``, ``velocity`` and ``normal`` (B, 3) each. Before the first message a receiver sees the start,
    which the reset gives as ``start`` (B, 9): one after the other.

    Args:
        rate: Measurements per second [Hz].
        noise_sd: Of place [m], velocity [m/s] and components of the normal [1].
    """

    outputs = dict.fromkeys(SEEN, VECTOR)
    inputs = ("deck",)
    free_rate = True

    def __init__(self, rate: float, noise_sd: tuple[float, float, float] = NOISE) -> None:
        super().__init__("deck_sensor", rate)
        self.noise_sd = noise_sd

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        level = torch.zeros(batch, 9, dtype=torch.float64)
        level[:, 8] = 1.0
        return {"start": level}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return {name: state["start"][:, 3 * i : 3 * i + 3] for i, name in enumerate(SEEN)}

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, noise
    ) -> tuple[State, dict[str, Tensor]]:
        pose = inputs["deck"].data
        spreads = zip(SEEN, self.noise_sd, strict=True)
        return state, {name: pose[name][:, -1] + spread * noise.normal(3) for name, spread in spreads}


def deck_start(incline: Tensor, speed: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """A start of a `Deck` at the origin, with heading, slope and turn rate drawn.

    Args:
        incline: (B,) [rad].
        speed: (B,) [m/s].
        generator: Of the draws.
    """
    batch = len(incline)
    angles = 2.0 * math.pi * torch.rand(2, batch, generator=generator, dtype=torch.float64)
    swing = torch.randn(batch, generator=generator, dtype=torch.float64)
    zero = torch.zeros(batch, dtype=torch.float64)
    return {
        "x": zero, "y": zero.clone(), "heading": angles[0], "slope": angles[1], "swing": swing,
        "incline": incline.clone(), "speed": speed.clone(),
    }  # fmt: skip


def deck_pose(state: State, parameters: Parameters | None = None) -> DeckPose:
    """Where a deck is in a state of its node, with parameters of the deck, or nominal ones."""
    x, y, heading, speed = (state[name] for name in ("x", "y", "heading", "speed"))
    # Made of the state: the compiled executor broadcasts no constants of its own.
    level = torch.zeros_like(x)
    return DeckPose(
        torch.stack([x, y, level], -1),
        torch.stack([speed * torch.cos(heading), speed * torch.sin(heading), level], -1),
        deck_normal(state["incline"], heading + state["slope"]),
        {**deck_parameters(), **(parameters or {})}["turn_spread"] * state["swing"],
    )

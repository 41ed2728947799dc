"""What sees a body touch a deck."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.landing import DECK_RADIUS, DeckPose, Meeting, carried, meeting
from deepkoco.systems.landing.touchdown import crossing, relative

NUMBER, VECTOR = ((), torch.float64), ((3,), torch.float64)
VECTORS = ("way", "closing", "axis", "normal")
TOLD = ("offset", "sink", "slip", "tilt")
"""What is told of a touch-down, see `Meeting`."""
SHOWN = ("way", "closing", "normal", "lean", "touched", *TOLD)


class Touchdown(Node):
    """Compares body and deck at its ticks; the first touch-down stays, to the time between two ticks.

    Inputs: ``world``, a `Flight`, and ``deck``, a `Deck`. A deck of another rate is carried on to the time of the body.

    Output, in parts: of now ``way`` and ``closing`` (B, 3), see `deepkoco.systems.landing.touchdown.relative`,
    ``normal`` (B, 3), and ``lean`` (B,), the angle between thrust axis and normal; and (B,) each, ``touched`` (0 or 1)
    and of the touch-down ``offset``, ``sink``, ``slip`` and ``tilt``, see `Meeting`; zero before.

    Args:
        rate: Ticks per second [Hz], as fast as the world: slower ones see the motion in coarser lines.
        radius: Of the deck [m].
    """

    inputs = ("world", "deck")
    outputs = {name: VECTOR if name in VECTORS else NUMBER for name in SHOWN}  # noqa: RUF012
    free_rate = True

    def __init__(self, rate: float, radius: float = DECK_RADIUS) -> None:
        super().__init__("touchdown", rate)
        self.radius = radius

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        zero = torch.zeros(batch, dtype=torch.float64)
        before = {name: torch.zeros(batch, 3, dtype=torch.float64) for name in VECTORS}
        return {
            **before,
            "begun": torch.zeros(batch, dtype=torch.bool),
            "lean": zero,
            **{name: zero.clone() for name in ("touched", *TOLD)},
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return {name: state[name] for name in SHOWN}

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input]
    ) -> tuple[State, dict[str, Tensor]]:
        world, deck = inputs["world"], inputs["deck"]
        body = world.data["state"][:, -1]
        age = world.t_sent[:, -1] - deck.t_sent[:, -1]
        # Before the first messages both show the start.
        age = torch.where(torch.isfinite(age), age, 0.0)
        pose = carried(DeckPose(**{name: deck.data[name][:, -1] for name in DeckPose._fields}), age)
        way, closing = relative(body[:, :3], body[:, 3:6], pose)
        now = {"way": way, "closing": closing, "axis": world.data["axis"][:, -1], "normal": pose.normal}
        begun = state["begun"][:, None]
        before = {name: torch.where(begun, state[name], now[name]) for name in VECTORS}
        heights = [(each["way"] * each["normal"]).sum(-1) for each in (before, now)]
        meets, share = crossing(*heights)
        at = {name: before[name] + share[:, None] * (now[name] - before[name]) for name in VECTORS}
        met: Meeting = meeting(at["way"], at["closing"], at["axis"], at["normal"])
        touches = meets & (met.offset <= self.radius) & (state["touched"] < 0.5)
        after = {
            **now,
            "begun": torch.ones_like(state["begun"]),
            "lean": meeting(*(now[name] for name in VECTORS)).tilt,
            "touched": torch.where(touches, 1.0, state["touched"]),
            **{name: torch.where(touches, getattr(met, name), state[name]) for name in TOLD},
        }
        return after, {name: after[name] for name in SHOWN}

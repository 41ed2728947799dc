"""How many commands a world must see, so that the one that holds is always among them."""

from __future__ import annotations

import math
from typing import Any

from deepkoco.graph import Delay, Node
from deepkoco.systems import Parameters, System


def command_window(delay: Delay, rate: float, world_rate: float, further: float = 0.0) -> int:
    """How many commands a tick of the world must see.

    Those under way may all arrive within one tick, and the one before them still holds; with a constant delay
    they keep their distance.

    Args:
        delay: From the agent to the world.
        rate: Commands per second [Hz].
        world_rate: Ticks per second [Hz].
        further: Longest delay of one command beyond that of all [s], see `System.further_delays`.
    """
    spread = 0.0 if delay.constant else delay.highest
    return 2 + math.ceil((spread + further + 1.0 / world_rate) * rate)


def longest_further_delay(system: System, parameters: Parameters) -> float:
    """Longest delay of one command beyond that of all [s]."""
    return max((float(delay.max()) for delay in system.further_delays(parameters) or ()), default=0.0)


def window_of_commands(world: Node, delay: Delay, sender: Node) -> int:
    """The same for a connection into a world with the nominal parameters of its system, if it has one."""
    system: Any = getattr(world, "system", None)
    further = longest_further_delay(system, system.default_parameters()) if system else 0.0
    return command_window(delay, float(sender.rate), float(world.rate), further)

"""The supervisor of a pool: what it sees, and what it pays."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.graph import Input, Supervisor
from deepkoco.graph.model.node import Parameters, State

LOWEST_PUMP = 0.1
"""Level at which the pump always runs: the pool needs some circulation."""
LARGEST_FLOW = 1.5e-3  # by which the observation is scaled [m3/s]
LARGEST = 30.0  # entry of an observation


class PoolSeat(Supervisor):
    """Gives a level of the heater, or the goal of a controller, and a level of the pump.

    Action (B, 2): heater in [0, 1], or the goal [deg C] where a controller moves the heater; and pump in [0.1, 1].

    The cost of a step is the squared distance of the pool from the goal [K2], and small weights of heat and of the
    power of the pump, which grows with the cube of its speed.

    Readings: ``observation`` (B, 4): the goal less the measured temperature [K], the goal less 30 deg C [K], the
    measured flow by the largest, and the goal less what a filter estimates, where there is one (else the measured
    temperature again). Then the past actions in [-1, 1], newest first. ``reward``, minus the cost. Further, (B,) each:
    ``measured``, what the thermometer shows, ``goal``, and of the truth ``temperature`` and ``transport_delay``.

    Args:
        rate: Decisions per second [Hz].
        history: How many past actions the observation has.
        controlled: A controller moves the heater.
        heat_weight, pump_weight: Of the cost, at full power [K2].
        **options: As for `Node`.
    """

    def __init__(
        self,
        rate: float,
        history: int = 0,
        controlled: bool = False,
        heat_weight: float = 0.01,
        pump_weight: float = 0.02,
        **options,
    ) -> None:
        first = torch.tensor([30.0 if controlled else 0.0, 1.0], dtype=torch.float64)
        super().__init__("agent", rate, initial_action=first, **options)
        self.history, self.controlled = history, controlled
        self.heat_weight, self.pump_weight = heat_weight, pump_weight

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        zero = torch.zeros(batch, dtype=torch.float64)
        return {
            "goal": torch.full_like(zero, 30.0),
            "before": torch.full_like(zero, 30.0),
            "actions": torch.zeros(batch, 2 * self.history, dtype=torch.float64),
        }

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        truth, probe = inputs["truth"].data, inputs["probe"].data
        goal = action[:, 0] if self.controlled else state["goal"]
        measured = probe["temperature"][:, -1]
        best = inputs["kalman"].data["state"][:, -1, 0] if "kalman" in inputs else measured
        pool = truth["pool"][:, -1]
        # Of the state in which the action was chosen.
        heat = torch.zeros_like(goal) if self.controlled else action[:, 0]
        cost = (
            (state["before"] - goal) ** 2 + self.heat_weight * heat**2 + self.pump_weight * action[:, 1] ** 3
        )
        flow = probe["flow"][:, -1] / LARGEST_FLOW
        parts = torch.stack([goal - measured, goal - 30.0, flow, goal - best], -1).clamp(-LARGEST, LARGEST)
        after = {"goal": goal, "before": pool, "actions": state["actions"]}
        if self.history:
            scaled = torch.stack(
                [2.0 * heat - 1.0, (2.0 * action[:, 1] - 1.0 - LOWEST_PUMP) / (1.0 - LOWEST_PUMP)], -1
            )
            after["actions"] = torch.cat([scaled, state["actions"][:, :-2]], 1)
            parts = torch.cat([parts, after["actions"]], 1)
        delay = truth["age"][:, -1]
        return after, {
            "observation": parts,
            "reward": -cost,
            "temperature": pool,
            "measured": measured,
            "goal": goal,
            "transport_delay": delay,
        }

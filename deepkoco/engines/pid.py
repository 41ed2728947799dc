"""A PID controller as a node."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State


class Pid(Node):
    """Proportional, integral and derivative action on one measured quantity y and its goal r.

        raw = bias + K (r - y) + I + D           u = raw cut to [low, high]
        I' = K / T_i (r - y) + (u - raw) / T_t   anti-windup: at a limit I follows what can be done (back-calculation)
        D  = -K T_d dy/dt, through a filter of first order with time constant T_d / 8, on y alone: no kick at a step

    D starts from the first y. Parameters of the node in the place of those given here: ``gain``, ``integral_time``
    and ``derivative_time``, each a scalar or (B,). Inputs ``goal`` and ``measured``; output u (B, 1).

    Args:
        name: Unique in the graph.
        rate: Ticks per second [Hz].
        gain: K, unit of u per unit of y.
        integral_time: T_i [s].
        derivative_time: T_d [s]; 0 for none.
        low, high: Limits of u.
        tracking_time: T_t [s]; None: T_i.
        bias: u without any error at the start.
        goal: From what the input `goal` shows last (B, ...) to r (B,); None: its first entry.
        measured: The same for `measured` and y.
        **options: As for `Node`.

    Raises:
        ValueError: A time is not above 0, another number is not finite, or the limits are none.

    Source: Astrom, Hagglund, Advanced PID control (2006), ch. 3.
    """

    inputs = ("goal", "measured")
    free_rate = True

    def __init__(
        self,
        name: str,
        rate: float | Fraction,
        gain: float,
        integral_time: float,
        derivative_time: float = 0.0,
        *,
        low: float,
        high: float,
        tracking_time: float | None = None,
        bias: float = 0.0,
        goal: Callable[[Any], Tensor] | None = None,
        measured: Callable[[Any], Tensor] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name, rate, **options)
        if not (math.isfinite(gain) and math.isfinite(bias) and low < high):
            raise ValueError(
                f"gain = {gain}, bias = {bias}, limits {low} to {high}: give numbers, low below high"
            )
        times = {"integral_time": integral_time, "tracking_time": tracking_time}
        for key, value in times.items():
            if value is not None and not value > 0.0:
                raise ValueError(f"{key} = {value} s; give a time above 0")
        if not 0.0 <= derivative_time < math.inf:
            raise ValueError(f"derivative_time = {derivative_time} s; give 0 or more")
        self.low, self.high, self.bias, self.tracking_time = low, high, bias, tracking_time
        settings = {"gain": gain, "integral_time": integral_time, "derivative_time": derivative_time}
        self.settings = {key: torch.tensor(value, dtype=torch.float64) for key, value in settings.items()}
        self._goal, self._measured = goal or _first_entry, measured or _first_entry

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        zero = torch.zeros(batch, dtype=torch.float64)
        return {
            "integral": zero.clone(),
            "filtered": zero.clone(),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.full((batch, 1), min(max(self.bias, self.low), self.high), dtype=torch.float64)

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, Tensor]:
        own = {**self.settings, **parameters}
        gain, integral_time, derivative_time = own["gain"], own["integral_time"], own["derivative_time"]
        measured = self._measured(_last(inputs["measured"]))
        error = self._goal(_last(inputs["goal"])) - measured
        filtered = torch.where(state["started"], state["filtered"], measured)
        # The filter by backward differences, so that no T_d is too short for it.
        share = dt / (derivative_time / 8.0 + dt)
        slope = share * (measured - filtered) / dt
        raw = self.bias + gain * error + state["integral"] - gain * derivative_time * slope
        command = raw.clamp(self.low, self.high)
        tracking = integral_time if self.tracking_time is None else self.tracking_time
        integral = state["integral"] + dt * (gain / integral_time * error + (command - raw) / tracking)
        after = {
            "integral": integral,
            "filtered": filtered + share * (measured - filtered),
            "started": torch.ones_like(state["started"]),
        }
        return after, command[:, None]


def _first_entry(shown: Tensor) -> Tensor:
    return shown[:, 0]


def _last(given: Input) -> Any:
    if isinstance(given.data, Tensor):
        return given.data[:, -1]
    return {name: part[:, -1] for name, part in given.data.items()}

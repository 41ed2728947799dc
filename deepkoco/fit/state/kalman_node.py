"""A linear Kalman filter in the graph, whose measurements may be as old as a message says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

import torch
from torch import Tensor

from deepkoco.engines.hold import held_integral
from deepkoco.fit.state.kalman import Gaussian, LinearModel, LinearModelError, predict, update
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State


class KalmanNode(Node):
    """State of a linear system now, from measurements of the past.

    A measurement shows the state of a time ago: its age. The filter's belief is that of the newest measured state. At
    each tick it goes on to the next measured state, under the commands that acted in between, and takes the
    measurement in; from there it goes on to now without one, under the commands since. A measurement of a state that is
    older than one that has been taken in, by more than half a period, is left out. Here the age is constant;
    :class:`AgedKalmanNode` is told it.

    Input ``sensor`` has the measurements (B, N), ``command`` the commands (B, M), with a window that reaches back to
    the oldest measured state: `commands_needed`.

    Output, in parts: ``state`` (B, S) now and ``covariance`` (B, S, S) of it.

    Args:
        name: Unique in the graph.
        rate: Ticks per second [Hz].
        model: Of the system; its longest step must hold those below.
        start: (S,) mean before the first measurement; entry `first` is then taken from it.
        start_sd: (S,) standard deviation of it.
        age: Of a measurement when it is sent [s].
        longest_age: Longest age of a measurement at a tick [s]; older ones are taken as so old.
        step: Longest integration step at the usual distances [s]. Over a step the mean of the commands is held: exact
            for a constant command, and for one that varies as fine as the step.
        commanded: From what the input holds (B, K, ...) to commands (B, K, M).
        measured: From what the sensor sends to measurements (B, K, N).
        **options: As for `Node`.

    Raises:
        LinearModelError: Sizes do not fit, or the model is made for shorter steps.

    Source: Kalman, A new approach to linear filtering and prediction problems (1960); prediction over the age as
        thesis alg. 6 does it for the unscented filter.
    """

    inputs = ("sensor", "command")

    def __init__(
        self,
        name: str,
        rate: float | Fraction,
        model: LinearModel,
        start: tuple[float, ...],
        start_sd: tuple[float, ...],
        *,
        age: float = 0.0,
        longest_age: float,
        step: float,
        commanded: Callable[[Any], Tensor] | None = None,
        measured: Callable[[Any], Tensor] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name, rate, **options)
        width = model.sensor.shape[1]
        if len(start) != width or len(start_sd) != width:
            raise LinearModelError(f"start and start_sd need {width} entries, one for each state")
        self.outputs = {"state": ((width,), torch.float64), "covariance": ((width, width), torch.float64)}
        if not 0.0 <= age <= longest_age:
            raise LinearModelError(f"age = {age:g} s; give 0 to the longest age, {longest_age:g} s")
        self.model, self.age, self.longest_age = model, age, longest_age
        self._commanded, self._measured = commanded or _as_it_is, measured or _as_it_is
        self._start = torch.tensor(start, dtype=torch.float64)
        self._spread = torch.diag(torch.tensor(start_sd, dtype=torch.float64) ** 2)
        # Between two measured states lies more than a period where the age shrinks, at most all of the age.
        self._steps = max(math.ceil((longest_age + 1.0 / float(rate)) / step - 1e-9), 1)
        self._steps_a_tick = max(math.ceil(1.0 / float(rate) / step - 1e-9), 1)
        longest = (longest_age + 2.0 / float(rate)) / self._steps
        if longest > model.longest_step * (1.0 + 1e-9):
            raise LinearModelError(
                f"steps of up to {longest:g} s; the model is made for {model.longest_step:g} s"
            )

    def commands_needed(self, rate: float) -> int:
        """Window of the connection with the commands, of which there are `rate` a second [Hz]."""
        return 2 + math.ceil((self.longest_age + 2.0 / float(self.rate)) * rate)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {
            "mean": self._start.expand(batch, -1).clone(),
            "covariance": self._spread.expand(batch, -1, -1).clone(),
            "since": torch.zeros(batch, dtype=torch.float64),
            "seen": torch.full((batch,), -2, dtype=torch.int64),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return {"state": state["mean"], "covariance": state["covariance"]}

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input]
    ) -> tuple[State, dict[str, Tensor]]:
        sensor, sent = inputs["sensor"], inputs["command"]
        held = self._commanded(sent.data).to(torch.float64)
        shown = self._measured(sensor.data).to(torch.float64)
        now = sensor.t_start
        older = self._age_of(inputs)
        belief = Gaussian(state["mean"], state["covariance"])
        since, seen = state["since"], state["seen"]
        # Without messages the belief goes on at the end of the known commands, and becomes less certain.
        oldest = torch.maximum(since, now - self.longest_age - 1.0 / float(self.rate))
        belief = self._carry(belief, since, oldest, held, sent.t_received, self._steps_a_tick)
        since = oldest
        for k in range(sensor.seq.shape[1]):
            seq = sensor.seq[:, k]
            new = seq > seen
            # What the sensor showed before its first message is of the start.
            taken = torch.where(seq < 0, since, sensor.t_sent[:, k] - older)
            # Fluids do not overtake each other, but a measured age scatters. What is clearly older is of no use.
            new = new & (taken >= since - 0.5 / float(self.rate))
            taken = torch.where(new, torch.maximum(taken, since), since)
            moved = self._carry(belief, since, taken, held, sent.t_received)
            after = update(moved, self.model, shown[:, k])
            belief = _where(new, after, belief)
            since, seen = taken, torch.maximum(seq, seen)
        current = self._carry(belief, since, torch.maximum(now, since), held, sent.t_received)
        kept = {"mean": belief.mean, "covariance": belief.covariance, "since": since, "seen": seen}
        return kept, {"state": current.mean, "covariance": current.covariance}

    def _age_of(self, inputs: dict[str, Input]) -> Tensor:
        """Age (B,) of what the sensor has sent last [s]."""
        return torch.full_like(inputs["sensor"].t_start, self.age)

    def _carry(
        self,
        belief: Gaussian,
        start: Tensor,
        stop: Tensor,
        held: Tensor,
        acts: Tensor,
        steps: int | None = None,
    ) -> Gaussian:
        """The belief at ``stop`` (B,) from that at ``start`` (B,) [s], in equal steps under their mean commands."""
        steps = self._steps if steps is None else steps
        step = (stop - start) / steps
        safe = torch.where(step > 0.0, step, 1.0)[:, None]
        transition = self.model.transition(step)
        for i in range(steps):
            begin = start + i * step
            belief = predict(belief, held_integral(held, acts, begin, begin + step) / safe, transition)
        return belief


class AgedKalmanNode(KalmanNode):
    """A Kalman filter that is told the age of its measurements, as of what comes through a pipe whose flow varies.

    As :class:`KalmanNode`, with the further input ``age`` (B, 1): how old a measurement is when it is sent [s].
    """

    inputs = ("sensor", "command", "age")

    def _age_of(self, inputs: dict[str, Input]) -> Tensor:
        return inputs["age"].data[:, -1, 0]


def _as_it_is(data: Any) -> Tensor:
    if isinstance(data, Mapping):
        raise LinearModelError(
            f"the input has parts {', '.join(data)}; say which one in `commanded` or `measured`"
        )
    return data


def _where(condition: Tensor, one: Gaussian, other: Gaussian) -> Gaussian:
    return Gaussian(
        torch.where(condition[:, None], one.mean, other.mean),
        torch.where(condition[:, None, None], one.covariance, other.covariance),
    )

"""Delays between an agent and an environment that knows none: when commands act and samples are seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.delay_arguments import (
    DelayWrapperError,
    episode_steps,
    read_delay,
    read_sensing,
    step_rate,
)
from deepkoco.graph import Connection, Delay, Graph, Node, Supervisor, draw_timing
from deepkoco.graph.delay import exact_fraction
from deepkoco.graph.model.node import State
from deepkoco.graph.timing.kernel import LOST

EXPECTATION = (64, 256)
"""Episodes and steps over which expected delays are means, without the first half of the steps."""


@dataclass(frozen=True)
class ExpectedDelays:
    """Mean delays as the agent meets them.

    Attributes:
        sensing: By name of the term, mean age of what the agent sees [s]: the delay of a sample, and the time until
            the next one arrives.
        actuation: Mean time from sending a command until it, or a newer one, acts [s].
    """

    sensing: Mapping[str, float]
    actuation: float


class DelayLine:
    """Arrivals of commands and samples for a batch of environments that step at one rate.

    The timing is that of a graph: agent and world tick together, sensors at their own rate; commands and
    samples travel with the delays of its connections. Step k of an environment is the time from tick k to tick
    k + 1. What a newer command or sample has overtaken is dropped.

    Args:
        batch: Environments B.
        rate: Steps per second [Hz].
        actuation: Delay from the agent to the environment [s].
        sensing: By name of the term, delay from the environment to the agent [s].
        sensor_rate: Samples per second [Hz], a whole multiple of `rate`.
        steps: Steps for which delays are drawn at first; an episode that goes on has more drawn.
        in_order: Commands and samples cannot overtake each other: one that would waits behind the one before.
    """

    def __init__(
        self,
        batch: int,
        rate: Fraction,
        actuation: Delay,
        sensing: Mapping[str, Delay],
        sensor_rate: Fraction,
        steps: int,
        in_order: bool = True,
    ) -> None:
        self.batch, self.rate = batch, rate
        self.samples_per_step = sensor_rate / rate
        if self.samples_per_step.denominator != 1:
            raise DelayWrapperError(
                f"sensor_rate = {float(sensor_rate):g} Hz: give a whole multiple of the {float(rate):g} Hz "
                "at which the environment steps"
            )
        self.terms = tuple(sensing)
        sensors = [_Clock(f"sensor {name}", sensor_rate) for name in sensing]
        agent = Supervisor(rate=rate, initial_action=torch.zeros(1), phase=0)
        connections = [
            Connection(sensor.name, "agent", delay=law, fifo=in_order)
            for sensor, law in zip(sensors, sensing.values(), strict=True)
        ]
        connections.append(Connection("agent", "world", delay=actuation, skip=True, fifo=in_order))
        self.graph = Graph([_Clock("world", rate), *sensors, agent], connections)
        self._steps = steps
        # Those that start together are drawn together; with its seed a group can be drawn for longer.
        self._group = np.zeros((batch, 3), np.int64)  # seed, size, place in the group
        self.step = np.zeros(batch, np.int64)
        self._ticks = np.zeros(0, np.int64)
        self._arrival = np.zeros((batch, 0), np.int64)
        self._sample = np.zeros((len(self.terms), batch, 0), np.int64)
        self.held, self.kept = 1, 1

    def restart(
        self,
        generator: np.random.Generator,
        mask: np.ndarray | None = None,
        own: Mapping[int, np.random.Generator] | None = None,
    ) -> None:
        """Draw delays for environments that begin a step 0.

        Args:
            generator: Where they come from.
            mask: (B,) bool, who starts; None: all.
            own: By place in the batch, generators of those that draw alone.
        """
        starting = np.arange(self.batch) if mask is None else np.flatnonzero(mask)
        self._group[starting, 0] = generator.integers(2**62)
        self._group[starting, 1] = len(starting)
        self._group[starting, 2] = np.arange(len(starting))
        for place, alone in (own or {}).items():
            self._group[place] = alone.integers(2**62), 1, 0
        self.step[starting] = 0
        self._draw(starting)

    def advance(self) -> None:
        """Go on to the next step."""
        self.step += 1
        if self.step.max() + 1 >= self._steps:
            self._steps *= 2
            self._draw(np.arange(self.batch))

    def weights(self) -> np.ndarray:
        """Share of this step over which each of the last `held` commands holds, (B, held), oldest first."""
        environment = np.arange(self.batch)[:, None]
        command = self.step[:, None] - np.arange(self.held - 1, -1, -1)
        begin, end = self._ticks[self.step][:, None], self._ticks[self.step + 1][:, None]
        arrival = np.where(command < 0, 0, self._arrival[environment, np.maximum(command, 0)])
        since = np.clip(arrival, begin, end)
        since[:, 0] = begin[:, 0]
        until = np.concatenate([since[:, 1:], end], 1)
        return (until - since) / (end - begin)

    def newest(self) -> np.ndarray:
        """Age of the newest command that has arrived at the begin of this step, in commands, (B,)."""
        environment = np.arange(self.batch)[:, None]
        command = self.step[:, None] - np.arange(self.held)
        there = self._arrival[environment, np.maximum(command, 0)] <= self._ticks[self.step][:, None]
        return np.argmax(there | (command < 0), axis=1)

    def command_delays(self) -> np.ndarray:
        """Time from sending to arrival [s] of each of the last `held` commands, newest first (B, held).

        Infinite of a command that has not arrived when this step begins. One that was overtaken counts as arrived with
        the one that overtook it.
        """
        environment = np.arange(self.batch)[:, None]
        command = self.step[:, None] - 1 - np.arange(self.held)
        known = np.maximum(command, 0)
        arrival, now = self._arrival[environment, known], self._ticks[self.step][:, None]
        there = (command >= 0) & (arrival <= now)
        return np.where(there, (arrival - self._ticks[known]) / self._ticks_per_second, np.inf)

    def ages(self, term: int) -> np.ndarray:
        """Age of what the agent sees of a term when this step begins [s], (B,)."""
        age, part = self.seen(term, now=True)
        return (age - part) / float(self.rate)

    def expected(self) -> ExpectedDelays:
        """Mean delays over episodes of their own, the same at every call."""
        size, steps = EXPECTATION
        arrival, sample, ticks = self._drawn(0, size, steps, np.arange(size))
        late = slice(steps // 2, steps)
        # The last commands may be lost, or arrive after the last step that was drawn.
        sent, come = ticks[:steps][late], arrival[:, late]
        delays = (come - sent)[come < LOST] / (float(ticks[1] - ticks[0]) * float(self.rate))
        ages = np.arange(steps + 1) - sample / int(self.samples_per_step)
        return ExpectedDelays(
            {
                term: float(age[:, late].mean() / float(self.rate))
                for term, age in zip(self.terms, ages, strict=True)
            },
            float(delays.mean()),
        )

    @property
    def _ticks_per_second(self) -> float:
        return float(self._ticks[1] - self._ticks[0]) * float(self.rate)

    def seen(self, term: int, now: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """What the agent sees of a term at the end of this step, or, at its begin, ``now``.

        Returns:
            Age of the newest sample that has arrived, in steps: the whole steps (B,), rounded up, and the part
            (B,) of the way from that step's observation to the next one.
        """
        tick, fine = self.step + (0 if now else 1), int(self.samples_per_step)
        sample = self._sample[term][np.arange(self.batch), tick]
        return tick - sample // fine, (sample % fine) / fine

    def _draw(self, environments: np.ndarray) -> None:
        steps = np.arange(self._steps + 1)
        arrival = np.zeros((self.batch, self._steps), np.int64)
        sample = np.zeros((len(self.terms), self.batch, self._steps + 1), np.int64)
        for seed, size in np.unique(self._group[environments, :2], axis=0).tolist():
            own = environments[self._group[environments, 0] == seed]
            place = self._group[own, 2]
            arrival[own], sample[:, own], self._ticks = self._drawn(seed, size, self._steps, place)
        if len(environments) < self.batch:
            others = np.setdiff1d(np.arange(self.batch), environments)
            arrival[others], sample[:, others] = self._arrival[others], self._sample[:, others]
        self._arrival, self._sample = arrival, sample
        for row in np.unique(arrival[environments], axis=0):
            there = np.searchsorted(row, self._ticks[:-1], "right")
            self.held = max(self.held, int((steps[:-1] - there).max()) + 2)
        age = steps - sample // int(self.samples_per_step)
        self.kept = max(self.kept, int(age.max()) + 1)

    def _drawn(
        self, seed: int, size: int, steps: int, place: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw for a group of environments.

        Args:
            seed: Of the group.
            size: Environments in it.
            steps: Steps.
            place: (R,) which of them are wanted.

        Returns:
            Arrival of each command (R, steps), by term the sample that the agent sees at each tick
            (terms, R, steps + 1), and the ticks (steps + 1,).
        """
        agent = self.graph.index["agent"]
        edges = {c.key: e for e, c in enumerate(self.graph.connections)}
        timing = draw_timing(self.graph, np.random.default_rng(seed), steps, size)
        rows, layout, tick = timing.row[place][:, None], timing.layout, np.arange(steps + 1)
        received = timing.t_received[rows, layout.message_base[edges["agent->world"]] + tick[:-1]]
        # Before the first arrival the agent sees what the reset returned: sample 0.
        windows = [
            timing.windows[rows, layout.window_base[edges[f"sensor {term}->agent"]] + tick]
            for term in self.terms
        ]
        sample = np.maximum.accumulate(np.maximum(windows, 0), axis=2)
        return _arrivals(received), sample, timing.steps_of(agent)[0]


def line_of(
    env: Any,
    batch: int,
    space: gymnasium.Space,
    actuation_delay: Any,
    sensing_delay: Any,
    control_rate: float | None,
    sensor_rate: float | None,
    in_order: bool = True,
) -> tuple[DelayLine, dict[str, str | slice | None]]:
    """Read the arguments of a delay wrapper.

    Args:
        env: The environment that is wrapped, or the batch of them.
        batch: Environments B.
        space: Of one observation.
        actuation_delay, sensing_delay, control_rate, sensor_rate, in_order: As for `DelayWrapper`.

    Returns:
        The line, and by term of the observation its place: a key, a slice, or None for the whole.

    Raises:
        DelayWrapperError: The rate is not known, or a delay does not fit the observation.
    """
    rate = step_rate(env, control_rate)
    laws, places = read_sensing(sensing_delay, space)
    actuation = read_delay("actuation_delay", actuation_delay)
    sampling = rate if sensor_rate is None else exact_fraction(sensor_rate)
    return DelayLine(batch, rate, actuation, laws, sampling, episode_steps(env), in_order), places


class _Clock(Node):
    """Ticks, and does nothing else: only its timing is wanted."""

    def initial_output(self, parameters: Any, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, 1)

    def step(self, parameters: Any, state: State, inputs: Any) -> tuple[State, Tensor]:
        return state, torch.zeros(1, 1)


def _arrivals(received: np.ndarray) -> np.ndarray:
    """Arrivals (R, steps) where one that never comes, or after a newer one, holds for no time before that."""
    return np.minimum.accumulate(received[:, ::-1], axis=1)[:, ::-1]

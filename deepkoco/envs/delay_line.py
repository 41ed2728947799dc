"""Delays between an agent and an environment that knows none: when commands act and samples are seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import Connection, Delay, Graph, Node, Supervisor, draw_timing, make_delay
from deepkoco.graph.delay import exact_fraction
from deepkoco.graph.node import State

_STREAM = 104_729  # keeps these draws apart from those of the environment with the same seed


class DelayWrapperError(ValueError):
    """Delays do not fit the environment that they are to be added to."""


class DelayLine:
    """Arrivals of commands and samples for a batch of environments that step at one rate.

    The timing is that of a graph: agent and world tick together, sensors at their own rate; commands and
    samples travel with the delays of its connections and cannot overtake each other. Step k of an environment
    is the time from tick k to tick k + 1.

    Args:
        batch: Environments B.
        rate: Steps per second [Hz].
        actuation: Delay from the agent to the environment [s].
        sensing: By name of the term, delay from the environment to the agent [s].
        sensor_rate: Samples per second [Hz], a whole multiple of `rate`.
        steps: Steps for which delays are drawn at first; an episode that goes on has more drawn.
    """

    def __init__(
        self,
        batch: int,
        rate: Fraction,
        actuation: Delay,
        sensing: Mapping[str, Delay],
        sensor_rate: Fraction,
        steps: int,
    ) -> None:
        self.batch, self.period = batch, 1 / rate
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
            Connection(sensor.name, "agent", delay=law)
            for sensor, law in zip(sensors, sensing.values(), strict=True)
        ]
        connections.append(Connection("agent", "world", delay=actuation, skip=True))
        self.graph = Graph([_Clock("world", rate), *sensors, agent], connections)
        self._steps = steps
        # Those that start together are drawn together; with its seed a group can be drawn for longer.
        self._group = np.zeros((batch, 3), np.int64)  # seed, size, place in the group
        self.step = np.zeros(batch, np.int64)
        self._ticks = np.zeros(0, np.int64)
        self._arrival = np.zeros((batch, 0), np.int64)
        self._sample = np.zeros((len(self.terms), batch, 0), np.int64)
        self.held, self.kept = 1, 1

    def restart(self, generator: np.random.Generator, mask: np.ndarray | None = None) -> None:
        """Draw delays for the environments in ``mask`` (B,) bool, by default for all, which begin a step 0."""
        starting = np.arange(self.batch) if mask is None else np.flatnonzero(mask)
        self._group[starting, 0] = generator.integers(2**62)
        self._group[starting, 1] = len(starting)
        self._group[starting, 2] = np.arange(len(starting))
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
        agent = self.graph.index["agent"]
        edges = {c.key: e for e, c in enumerate(self.graph.connections)}
        commands, samples = edges["agent->world"], [edges[f"sensor {t}->agent"] for t in self.terms]
        steps = np.arange(self._steps + 1)
        arrival = np.zeros((self.batch, self._steps), np.int64)
        sample = np.zeros((len(self.terms), self.batch, self._steps + 1), np.int64)
        for seed, size in np.unique(self._group[environments, :2], axis=0).tolist():
            timing = draw_timing(self.graph, np.random.default_rng(seed), self._steps, size)
            self._ticks = timing.steps_of(agent)[0]
            own = environments[self._group[environments, 0] == seed]
            rows = timing.row[self._group[own, 2]][:, None]
            layout = timing.layout
            arrival[own] = _arrivals(timing.t_received[rows, layout.message_base[commands] + steps[:-1]])
            for term, edge in enumerate(samples):
                # Before the first arrival the agent sees what the reset returned: sample 0.
                seen = timing.windows[rows, layout.window_base[edge] + steps]
                sample[term, own] = np.maximum(seen, 0)
        if len(environments) < self.batch:
            others = np.setdiff1d(np.arange(self.batch), environments)
            arrival[others], sample[:, others] = self._arrival[others], self._sample[:, others]
        self._arrival, self._sample = arrival, sample
        for row in np.unique(arrival[environments], axis=0):
            there = np.searchsorted(row, self._ticks[:-1], "right")
            self.held = max(self.held, int((steps[:-1] - there).max()) + 2)
        age = steps - sample // int(self.samples_per_step)
        self.kept = max(self.kept, int(age.max()) + 1)


class _Clock(Node):
    """Ticks, and does nothing else: only its timing is wanted."""

    def init(self, parameters: Any, generator: torch.Generator, batch: int) -> State:
        return {}

    def initial_output(self, parameters: Any, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, 1)

    def step(self, parameters: Any, state: State, inputs: Any) -> tuple[State, Tensor]:
        return state, torch.zeros(1, 1)


def step_rate(env: Any, given: float | None) -> Fraction:
    """Steps per second of an environment [Hz]: as given, else from its `dt` [s], else from its metadata.

    Raises:
        DelayWrapperError: It does not say, or what was given is no rate.
    """
    if given is not None:
        if not (given > 0 and math.isfinite(given)):
            raise DelayWrapperError(f"control_rate = {given} Hz; give a positive number")
        return exact_fraction(given)
    inner = getattr(env, "envs", [env])[0].unwrapped
    dt = getattr(inner, "dt", None)
    if isinstance(dt, (float, int)) and dt > 0:
        return 1 / exact_fraction(float(dt))
    rate = (inner.metadata or {}).get("render_fps")
    if not rate:
        name = env.spec.id if env.spec is not None else type(inner).__name__
        raise DelayWrapperError(
            f"{name} has neither dt nor render_fps: pass control_rate, its steps per second [Hz]"
        )
    return exact_fraction(float(rate))


def episode_steps(env: Any) -> int:
    """Steps of an episode where the environment has a limit, else a first guess."""
    limit = env.spec.max_episode_steps if env.spec is not None else None
    return (limit or 256) + 2


def seeded(seed: int | None) -> np.random.Generator:
    """Generator of the delays for a reset with this seed."""
    return np.random.default_rng(None if seed is None else [_STREAM, seed])


def read_sensing(
    delay: Any, space: gymnasium.Space
) -> tuple[dict[str, Delay], dict[str, str | slice | None]]:
    """Read the sensing delay of an observation, or of its terms.

    Args:
        delay: A delay, or by term: a key of a Dict space, or of a flat Box an index or "first:stop".
        space: Of the observation.

    Returns:
        By term, its delay and which part of the observation it is: a key, a slice, or None for the whole.
        A part of the observation that no term names has no delay.

    Raises:
        DelayWrapperError: A term is no part of the observation, or two overlap.
    """
    if not isinstance(delay, Mapping) or "law" in delay:
        return {"observation": make_delay(delay)}, {"observation": None}
    laws: dict[str, Delay] = {}
    places: dict[str, str | slice | None] = {}
    if isinstance(space, gymnasium.spaces.Dict):
        for key in delay:
            if key not in space.spaces:
                raise DelayWrapperError(
                    f'sensing_delay: "{key}" is no key of the observation; it has {", ".join(space.spaces)}'
                )
        for key in space.spaces:
            laws[key], places[key] = make_delay(delay.get(key, 0.0)), key
        return laws, places
    size = space.shape[0] if isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1 else 0
    if not size:
        raise DelayWrapperError(f"sensing_delay: terms need a Dict or a flat Box observation, not {space}")
    taken = np.zeros(size, bool)
    for key, law in delay.items():
        part = _range(key, size)
        if taken[part].any():
            raise DelayWrapperError(f'sensing_delay: "{key}" overlaps with another term')
        taken[part] = True
        laws[str(key)], places[str(key)] = make_delay(law), part
    begin = np.flatnonzero(np.diff(np.concatenate([[1], taken.astype(int), [1]])) < 0)
    stop = np.flatnonzero(np.diff(np.concatenate([[1], taken.astype(int), [1]])) > 0)
    for first, last in zip(begin.tolist(), stop.tolist(), strict=True):
        laws[f"{first}:{last}"], places[f"{first}:{last}"] = make_delay(0.0), slice(first, last)
    return laws, places


def _range(key: Any, size: int) -> slice:
    text = str(key)
    first, _, stop = text.partition(":")
    try:
        begin = int(first)
        end = int(stop) if ":" in text else begin + 1
    except ValueError:
        begin, end = 0, 0
    if not 0 <= begin < end <= size:
        raise DelayWrapperError(
            f'sensing_delay: "{key}" is no part of {size} entries; give an index or "first:stop"'
        )
    return slice(begin, end)


def _arrivals(received: np.ndarray) -> np.ndarray:
    """Arrivals without losses (R, steps): one that never comes holds for no time before the next one."""
    return np.minimum.accumulate(received[:, ::-1], axis=1)[:, ::-1]

"""What the delay wrappers are told: rates, and delays of the terms of an observation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import gymnasium
import numpy as np

from deepkoco.graph import Delay, make_delay
from deepkoco.graph.delay import DelayError, exact_fraction

_STREAM = 104_729  # keeps these draws apart from those of the environment with the same seed


class DelayWrapperError(ValueError):
    """Delays do not fit the environment that they are to be added to."""


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


def read_delay(name: str, delay: Any) -> Delay:
    """Make a delay law of an argument.

    Raises:
        DelayWrapperError: It is none; the message names the argument.
    """
    try:
        return make_delay(delay)
    except DelayError as error:
        raise DelayWrapperError(f"{name}: {error}") from error


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
        return {"observation": read_delay("sensing_delay", delay)}, {"observation": None}
    laws: dict[str, Delay] = {}
    places: dict[str, str | slice | None] = {}
    if isinstance(space, gymnasium.spaces.Dict):
        for key in delay:
            if key not in space.spaces:
                raise DelayWrapperError(
                    f'sensing_delay: "{key}" is no key of the observation; it has {", ".join(space.spaces)}'
                )
        for key in space.spaces:
            laws[key], places[key] = read_delay(f'sensing_delay "{key}"', delay.get(key, 0.0)), key
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
        laws[str(key)], places[str(key)] = read_delay(f'sensing_delay "{key}"', law), part
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

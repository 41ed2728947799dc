"""Procedural video behind the task: smooth moving noise, drifting gratings and wandering blobs."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from deepkoco.envs.distractors.clips import Clips
from deepkoco.envs.distractors.options import Setup

FRAMES = 128  # of one loop, at 20 Hz 6.4 s
TAU = 2.0 * np.pi


def background(setup: Setup) -> Clips:
    """Moving patterns, made from waves and blobs that repeat after 128 frames without a seam.

    The patterns of the two splits have other seeds; training and evaluation share none.
    """
    words = tuple(setup.words)
    pattern = partial(make_pattern, words, size=setup.size)
    return Clips(setup, pattern, setup.options.patterns, there_and_back=False)


@lru_cache(maxsize=64)  # 1.5 MiB each at 64 x 64
def make_pattern(words: tuple[int, ...], number: int, size: int) -> np.ndarray:
    """One pattern.

    Args:
        words: Seed words of the distractor and its split.
        number: Of the pattern; its kind is `KINDS` in turn.
        size: Side [pixels].

    Returns:
        uint8 (128, size, size, 3), not to be written into.
    """
    generator = np.random.default_rng([*words, number])
    field = KINDS[number % len(KINDS)](generator, size)
    scaled = 127.5 + 55.0 * (field - field.mean()) / field.std()
    clip = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
    clip.flags.writeable = False
    return clip


def smooth_noise(generator: np.random.Generator, size: int) -> np.ndarray:
    """Many slow waves of low frequency in all directions, (F, size, size, 3)."""
    waves = generator.integers(-3, 4, size=(24, 2))
    turns = generator.choice([-3, -2, -1, 1, 2, 3], size=24)
    return _waves(generator, waves, turns, size)


def gratings(generator: np.random.Generator, size: int) -> np.ndarray:
    """Two gratings that drift across each other, (F, size, size, 3)."""
    angle = generator.uniform(0.0, TAU, size=2)
    waves = generator.uniform(3.0, 7.0, size=(2, 1)) * np.stack([np.cos(angle), np.sin(angle)], 1)
    turns = generator.choice([-8, -6, -4, 4, 6, 8], size=2)
    return _waves(generator, waves, turns, size)


def blobs(generator: np.random.Generator, size: int) -> np.ndarray:
    """Coloured blobs on closed paths, (F, size, size, 3)."""
    count = 7
    time = np.linspace(0.0, TAU, FRAMES, endpoint=False)[:, None]
    grid = (np.arange(size) + 0.5) / size
    profiles = []
    for _ in range(2):
        turns = generator.integers(1, 4, size=count)
        centre = generator.uniform(0.2, 0.8, size=count)
        centre = centre + 0.3 * np.sin(turns * time + generator.uniform(0.0, TAU, size=count))
        profiles.append(np.exp(-0.5 * ((grid - centre[..., None]) / 0.11) ** 2))  # (F, K, size)
    colours = generator.uniform(-1.0, 1.0, size=(count, 3))
    return np.einsum("fky,fkx,kc->fyxc", *profiles, colours, optimize=True)


def _waves(generator: np.random.Generator, waves: np.ndarray, turns: np.ndarray, size: int) -> np.ndarray:
    """Sum of plane waves (K, 2) [1/side] that turn ``turns`` (K,) times in a loop, with other phases per colour."""
    grid = (np.arange(size) + 0.5) / size
    along = waves[:, 0, None, None] * grid[:, None] + waves[:, 1, None, None] * grid
    phase = TAU * along[..., None] + generator.uniform(0.0, TAU, size=(len(waves), 1, 1, 3))
    turn = TAU * np.outer(np.arange(FRAMES) / FRAMES, turns)  # (F, K)
    # cos(a + b) = cos a cos b - sin a sin b makes the whole clip two matrix products.
    field = np.cos(turn) @ np.cos(phase).reshape(len(waves), -1)
    field -= np.sin(turn) @ np.sin(phase).reshape(len(waves), -1)
    return field.reshape(FRAMES, size, size, 3)


KINDS: tuple[Callable[[np.random.Generator, int], np.ndarray], ...] = (smooth_noise, gratings, blobs)

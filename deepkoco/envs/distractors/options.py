"""What every distractor is made from: options, intensity, split and the generators that follow from a seed."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import gymnasium
import numpy as np

SPLITS = ("train", "evaluation")
BELOW, AROUND = LAYOUTS = ("below", "around")
ITSELF = "itself"
"""Copies of the environment of the task itself, whichever it is."""
Copied = str | Callable[[], gymnasium.Env]
"""What copies are of: the name of a task of ours, or what makes one more environment."""
_STREAM = 7919  # keeps the distractors' draws apart from those of the environment with the same seed


class DistractorError(ValueError):
    """Distractors that are unknown, or options that do not fit them."""


@dataclass
class DistractorOptions:
    """Options of all distractors; each reads those that it needs."""

    intensity: float = 1.0
    """How strong all of them are, 0 (none) to 1."""
    intensities: dict[str, float] = field(default_factory=dict)
    """Intensity of single ones by name, in the place of `intensity`."""
    copies: int = 4
    """copies: further systems; the thesis has four pendulums."""
    drive: str = "ou"
    """copies: their commands, "ou" (Ornstein-Uhlenbeck), "random" (uniform, anew at every step), or "action": that of
    the agent, from other start states; the thesis does not say how its distractors are driven."""
    layout: str = BELOW
    """copies in frames: "below" the task, which keeps its size and covers them, or "around" it: all of one size, the
    task in the middle, as in the thesis."""
    occlusion: float = 0.0
    """copies in frames, around: how much wider than its place in the grid each system is drawn, 0 to 1; the copies
    then cover parts of the task."""
    episodes: int = 500
    """copies of an environment that is not ours: episodes that are recorded in each split, and then played again."""
    channels: int = 12
    """noise, projection: entries of noise that are added to the observation."""
    patterns: int = 8
    """background: moving patterns in each split."""
    videos: str | None = None
    """video: folder of videos, or of folders with the pictures of one video each."""
    evaluation_videos: str | None = None
    """video: the same for evaluation; by default every third video of `videos`, which training then leaves out."""
    video_frames: int = 256
    """video: most pictures kept of one video."""

    def check(self) -> None:
        """Check the values.

        Raises:
            DistractorError: Names the first value that is out of range and its remedy.
        """
        named = {"intensity": self.intensity, **{f"intensities.{k}": v for k, v in self.intensities.items()}}
        for name, value in named.items():
            if not 0.0 <= value <= 1.0:
                raise DistractorError(f"distractor_options.{name} = {value}; give a number from 0 to 1")
        if self.layout not in LAYOUTS:
            choices = ", ".join(LAYOUTS)
            raise DistractorError(f'distractor_options.layout = "{self.layout}"; choose one of {choices}')
        if not 0.0 <= self.occlusion <= 1.0:
            raise DistractorError(
                f"distractor_options.occlusion = {self.occlusion}; give a number from 0 to 1"
            )
        if self.occlusion and self.layout != AROUND:
            raise DistractorError(
                f'distractor_options.occlusion = {self.occlusion} needs distractor_options.layout = "{AROUND}": '
                "copies below the task cover nothing of it"
            )
        for name in ("copies", "episodes", "channels", "patterns", "video_frames"):
            if getattr(self, name) < 1:
                raise DistractorError(f"distractor_options.{name} = {getattr(self, name)}; give 1 or more")


@dataclass(frozen=True)
class Setup:
    """What one distractor of a batch of environments is made from.

    Attributes:
        name: Of the distractor.
        batch: Environments B.
        intensity: 0 to 1.
        system: What copies are of.
        actions: Entries M of the agent's action.
        options: Options of all distractors.
        split: "train" or "evaluation": other draws, other patterns, other videos.
        size: Side of a frame [pixels].
    """

    name: str
    batch: int
    intensity: float
    system: Copied = "rod_pendulum"
    actions: int = 1
    options: DistractorOptions = field(default_factory=DistractorOptions)
    split: str = "train"
    size: int = 64

    def generator(self, seed: int | Sequence[int]) -> np.random.Generator:
        """Generator of this distractor for a reset with a seed, or with one for each environment."""
        return np.random.default_rng([*self.words, *np.atleast_1d(seed).tolist()])

    @property
    def words(self) -> list[int]:
        """Seed words that tell this distractor and this split from all others."""
        return [_STREAM, SPLITS.index(self.split), zlib.crc32(self.name.encode())]

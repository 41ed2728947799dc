"""Names of the distractors: a new one is one file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from deepkoco.envs.distractors.background import background
from deepkoco.envs.distractors.camera import CameraPose
from deepkoco.envs.distractors.colour import ColourShift
from deepkoco.envs.distractors.options import Copied, DistractorError, DistractorOptions, Setup
from deepkoco.envs.distractors.pixel_copies import PixelCopies
from deepkoco.envs.distractors.sensor_noise import SensorNoise
from deepkoco.envs.distractors.state_copies import state_copies
from deepkoco.envs.distractors.state_noise import NoiseChannels
from deepkoco.envs.distractors.state_source import StateSource
from deepkoco.envs.distractors.video import video
from deepkoco.envs.frames import Layer

STATE: dict[str, Callable[[Setup], StateSource]] = {
    "copies": state_copies,
    "noise": NoiseChannels,
    "projection": NoiseChannels,  # the rotation of all entries together is the wrapper's
}
# In the order in which they act: what lies below the task, then the picture as a whole, then its camera.
PIXEL: dict[str, Callable[[Setup], Layer]] = {
    "background": background,
    "video": video,
    "copies": PixelCopies,
    "colour": ColourShift,
    "camera": CameraPose,
    "sensor_noise": SensorNoise,
}

Made = TypeVar("Made")


def parse_distractors(text: str, known: Sequence[str]) -> list[str]:
    """Names in a text like ``copies+noise``.

    Args:
        text: "none", a name, or names joined by "+".
        known: Names there are.

    Returns:
        The names, in the order of ``known``.

    Raises:
        DistractorError: A name is unknown or is given twice.
    """
    if text == "none":
        return []
    names = text.split("+")
    if unknown := [name for name in names if name not in known]:
        choice = f'choose none, {", ".join(known)}, or several joined by "+"'
        if unknown[0] in PIXEL or unknown[0] in STATE:
            needed, seen = ("images", "states") if unknown[0] in PIXEL else ("states", "images")
            raise DistractorError(
                f'distractors = "{text}": "{unknown[0]}" is for an agent that sees {needed}, and this one sees {seen}; '
                f"add observation={needed}, or {choice}"
            )
        raise DistractorError(f'distractors = "{text}": there is no "{unknown[0]}"; {choice}')
    if len(set(names)) < len(names):
        raise DistractorError(f'distractors = "{text}": name each of them once')
    return [name for name in known if name in names]


def make_distractors(
    registry: dict[str, Callable[[Setup], Made]],
    text: str,
    batch: int,
    options: DistractorOptions,
    system: Copied,
    split: str,
    size: int = 64,
    actions: int = 1,
) -> dict[str, Made]:
    """Make the distractors of a batch of environments.

    Args:
        registry: Those of states, or those of frames.
        text: Which of them; see `parse_distractors`.
        batch: Environments B.
        options: Of all of them.
        system: What copies are of.
        split: "train" or "evaluation".
        size: Side of a frame [pixels].
        actions: Entries M of the agent's action.

    Returns:
        The distractors by name.

    Raises:
        DistractorError: A name is unknown, or an option is out of range or belongs to none of them.
    """
    names = parse_distractors(text, list(registry))
    options.check()
    if stray := [name for name in options.intensities if name not in names]:
        raise DistractorError(
            f'distractor_options.intensities.{stray[0]}: distractors = "{text}" has no such distractor'
        )
    made = {}
    for name in names:
        intensity = options.intensities.get(name, options.intensity)
        made[name] = registry[name](Setup(name, batch, intensity, system, actions, options, split, size))
    return made

"""How a system looks: a bar for each channel, unless it draws itself."""

from __future__ import annotations

import math

import numpy as np

from deepkoco.systems.channel import Channel
from deepkoco.systems.drawing import Point, canvas, draw_bars

Outline = tuple[list[tuple[Point, Point]], list[Point]]


class Drawn:
    """Pictures of a system.

    Attributes:
        commands: The command channels.
        measurements: The measurement channels.
    """

    commands: tuple[Channel, ...]
    measurements: tuple[Channel, ...]

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        """Draw the system onto a picture, whatever that shows already: by default a bar for each channel.

        Args:
            image: uint8 (size, size, 3), RGB, of any size; it may be a part of a larger picture.
            measurement: (N,) values in the order of ``measurements``.
            command: Commands now (M,), in their units, to be drawn too.
        """
        shown = None if command is None else np.ravel(command)
        draw_bars(
            image,
            [_share(value, c) for value, c in zip(measurement, self.measurements, strict=False)],
            []
            if shown is None
            else [_share(value, c) for value, c in zip(shown, self.commands, strict=False)],
        )

    def outline(self, angles: np.ndarray) -> Outline | None:
        """Lines of its links and points of its joints in a plane [m], for figures; None where there are none.

        Args:
            angles: (J,) joint coordinates [rad or m].
        """
        return None

    def draw(self, measurement: np.ndarray, command: np.ndarray | float, size: int = 256) -> np.ndarray:
        """Picture of the system on an empty background, uint8 (size, size, 3), RGB; see `draw_on`."""
        image = canvas(size)
        self.draw_on(image, measurement, command)
        return image


def _share(value: float, channel: Channel) -> float:
    """A value in [-1, 1] for a picture: of the channel's limits, of half a turn, or softly bounded."""
    if channel.angle or (channel.unit == "rad" and not math.isfinite(channel.high)):
        return math.remainder(float(value), 2.0 * math.pi) / math.pi
    largest = max(abs(channel.low), abs(channel.high))
    return float(value) / largest if math.isfinite(largest) and largest > 0 else math.tanh(float(value))

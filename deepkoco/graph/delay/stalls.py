"""Shared stalls: instants at which everything named is held up at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepkoco.graph.delay.law import Delay, DelayError, between, make_delay, seconds


@dataclass(frozen=True)
class Stalls:
    """Stretches of time in which no named computation or message makes progress.

    Between the end of one stall and the begin of the next pass `refractory` seconds and then an exponential
    time, so that there are `rate` stalls a second in the long run. An episode begins at a random instant
    between two stalls. Whatever is under way when a stall begins, or would begin during it, goes on when the
    stall is over: its delay grows by exactly the time for which the two overlap.

    Attributes:
        rate: stalls per second in the long run [Hz].
        duration: law of their length [s].
        refractory: shortest time from the end of a stall to the next [s].
        channels: names of nodes (their computation) and keys of connections that are held up; None: all.
    """

    rate: float
    duration: Delay | float | Mapping[str, Any]
    refractory: float = 0.0
    channels: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", between("stalls: rate [Hz]", self.rate, 0.0, 1e6))
        object.__setattr__(self, "duration", make_delay(self.duration))
        object.__setattr__(self, "refractory", seconds("stalls: refractory", self.refractory))
        if self.channels is not None:
            if isinstance(self.channels, str):
                raise DelayError(f'stalls: channels "{self.channels}" is one name; give a list of names')
            object.__setattr__(self, "channels", tuple(self.channels))
        law = self.law
        if law.loses or law.marginal is not law:
            raise DelayError(f"stalls: durations are independent and finite, not {law.law}")
        if self.rate and self.quiet < 0:
            raise DelayError(
                f"stalls: {self.rate} stalls a second of {law.mean} s with {self.refractory} s between them "
                "do not fit into a second"
            )

    @property
    def law(self) -> Delay:
        """The duration as a law."""
        return make_delay(self.duration)

    @property
    def quiet(self) -> float:
        """Mean of the exponential time between two stalls, after `refractory` [s]; infinite without any."""
        return 1.0 / self.rate - self.refractory - self.law.mean if self.rate else np.inf

    def stream(self, rows: int) -> "StallStream":
        """Return what draws the stalls of `rows` episodes, one after the other."""
        return StallStream(self, rows)

    def to_dict(self) -> dict[str, Any]:
        """Describe the process in plain numbers, strings and lists."""
        return {
            "rate": self.rate,
            "duration": self.law.to_dict(),
            "refractory": self.refractory,
            "channels": None if self.channels is None else list(self.channels),
        }


class StallStream:
    """Stalls of several episodes in succession."""

    def __init__(self, stalls: Stalls, rows: int) -> None:
        self._stalls = stalls
        self._end: np.ndarray | None = None
        self._rows = rows

    def draw(self, generator: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return begin and end of the next `count` stalls, (rows, count) each [s]; infinite: none."""
        stalls = self._stalls
        shape = self._rows, count
        if not stalls.rate:
            return np.full(shape, np.inf), np.full(shape, np.inf)
        wait = stalls.refractory + stalls.quiet * generator.standard_exponential(shape)
        duration = stalls.law.sample(generator, shape)
        if self._end is None:
            # Residual time of the renewal process: the first wait of a process that has gone on for ever.
            self._end = np.zeros(self._rows)
            whole = stalls.refractory + stalls.quiet
            part = generator.random(self._rows) * whole
            wait[:, 0] = np.where(part < stalls.refractory, wait[:, 0] - part, wait[:, 0] - stalls.refractory)
        end = self._end[:, None] + np.cumsum(wait + duration, axis=1)
        self._end = end[:, -1]
        return end - duration, end


def make_stalls(spec: Stalls | Mapping[str, Any]) -> Stalls:
    """Build a stall process from its description or return it.

    Raises:
        DelayError: the description does not fit.
    """
    if isinstance(spec, Stalls):
        return spec
    try:
        return Stalls(**spec)
    except TypeError as error:
        raise DelayError(f"stalls: {error}") from error

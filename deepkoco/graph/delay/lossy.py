"""Messages that get lost."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deepkoco.graph.delay.law import Delay, DelayError, Stream, between, make_delay, register


@register
@dataclass(frozen=True)
class Lossy(Delay):
    """A message gets lost with probability `probability`, and otherwise takes what `delay` says.

    `mean` and `highest` are those of the messages that arrive. For connections only.
    """

    delay: Delay
    probability: float
    law = "lossy"

    def __post_init__(self) -> None:
        object.__setattr__(self, "delay", make_delay(self.delay))
        if self.delay.loses:
            raise DelayError("lossy: its delay is lossy already")
        object.__setattr__(
            self, "probability", between("lossy: probability", self.probability, 0.0, 1.0, closed=False)
        )

    @property
    def mean(self) -> float:
        return self.delay.mean

    @property
    def highest(self) -> float:
        return self.delay.highest

    @property
    def constant(self) -> bool:
        return self.probability == 0.0 and self.delay.constant

    @property
    def loses(self) -> bool:
        return self.probability > 0.0

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        return (1.0 - self.probability) * self.delay.cdf(delay)

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        return _lose(generator, self.delay.sample(generator, shape), self.probability)

    def stream(self, rows: int, period: float, start: float = 0.0) -> "_LossyStream":
        return _LossyStream(self, rows, period, start)

    def to_dict(self) -> dict[str, Any]:
        return {"law": self.law, "delay": self.delay.to_dict(), "probability": self.probability}


class _LossyStream(Stream):
    """Losses are independent of each other; the delays come from the stream of their own law."""

    def __init__(self, law: Lossy, rows: int, period: float, start: float) -> None:
        super().__init__(law, rows)
        self._probability = law.probability
        self._delays = law.delay.stream(rows, period, start)

    def draw(self, generator: np.random.Generator, columns: int) -> np.ndarray:
        return _lose(generator, self._delays.draw(generator, columns), self._probability)


def _lose(generator: np.random.Generator, delays: np.ndarray, probability: float) -> np.ndarray:
    return np.where(generator.random(delays.shape) < probability, np.inf, delays)

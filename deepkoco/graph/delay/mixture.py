"""Laws put together from others or from measured delays."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr

from deepkoco.graph.delay.law import Delay, DelayError, make_delay, register, seconds

_CELLS = 512  # of the table that brackets a mixture's quantiles
_SMALLEST = 1e-11  # [s] to which they are then found


@register
@dataclass(frozen=True)
class Mixture(Delay):
    """Draws from component i with probability weights[i]."""

    components: tuple[Delay, ...]
    weights: tuple[float, ...]
    law = "mixture"

    def __post_init__(self) -> None:
        components = tuple(make_delay(component) for component in self.components)
        weights = np.asarray(self.weights, dtype=np.float64)
        if not components or weights.shape != (len(components),):
            raise DelayError(
                f"mixture: {len(components)} components and {weights.size} weights; give one each"
            )
        if not np.isfinite(weights).all() or (weights < 0).any() or weights.sum() <= 0:
            raise DelayError(f"mixture: weights {self.weights} are negative, not finite or all zero")
        for component in components:
            if component.timed:
                raise DelayError(
                    f"mixture: {component.law} depends on the time, of which a mixture knows nothing"
                )
            if component.loses or component.marginal is not component:
                raise DelayError(
                    f"mixture: put the mixture into {component.law}, not {component.law} into it"
                )
        object.__setattr__(self, "components", components)
        if abs(weights.sum() - 1.0) > 1e-12:
            weights = weights / weights.sum()
        object.__setattr__(self, "weights", tuple(weights.tolist()))

    @property
    def mean(self) -> float:
        return sum(w * law.mean for w, law in zip(self.weights, self.components, strict=True))

    @property
    def highest(self) -> float:
        return max(law.highest for law in self.components)

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        parts = [w * law.cdf(delay) for w, law in zip(self.weights, self.components, strict=True)]
        return np.sum(parts, axis=0)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        level = np.asarray(level, dtype=np.float64)
        levels, delays = self._brackets
        place = np.clip(np.searchsorted(levels, level), 1, len(levels) - 1)
        return self._bisect(level, delays[place - 1], delays[place], float(np.diff(delays).max()))

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        chosen = np.searchsorted(np.cumsum(self.weights)[:-1], generator.random(shape), side="right")
        draws = np.empty(shape)
        for i, law in enumerate(self.components):
            here = chosen == i
            draws[here] = law.sample(generator, (int(here.sum()),))
        return draws

    def to_dict(self) -> dict[str, Any]:
        components = [law.to_dict() for law in self.components]
        return {"law": self.law, "components": components, "weights": list(self.weights)}

    @cached_property
    def _brackets(self) -> tuple[np.ndarray, np.ndarray]:
        """Levels, evenly spaced in their normal scores, and their quantiles."""
        levels = ndtr(np.linspace(-8.3, 8.3, _CELLS + 1))
        levels[0], levels[-1] = 0.0, 1.0
        whole = np.full(levels.shape, self.highest * (1 + 1e-12))
        return levels, self._bisect(levels, np.zeros_like(whole), whole, float(whole[0]))

    def _bisect(self, level: np.ndarray, low: np.ndarray, high: np.ndarray, width: float) -> np.ndarray:
        """Halve intervals of at most `width` until the smallest delay with cdf >= level is known.

        Right for jumps of the cdf, too. The number of halvings does not depend on what else is looked up.
        """
        for _ in range(max(math.ceil(math.log2(max(width, _SMALLEST) / _SMALLEST)), 0)):
            middle = 0.5 * (low + high)
            below = self.cdf(middle) < level
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return high


@register
@dataclass(frozen=True)
class Empirical(Delay):
    """Draws with replacement from measured delays [s]."""

    samples: tuple[float, ...]
    law = "empirical"

    def __post_init__(self) -> None:
        array = np.ravel(np.asarray(self.samples))
        if array.dtype.kind == "f" and np.isfinite(array).all() and (array >= 0).all():
            samples = tuple(array.tolist())
        else:
            samples = tuple(seconds("samples", sample) for sample in array.tolist())
        if not samples:
            raise DelayError("empirical: no samples given")
        object.__setattr__(self, "samples", samples)

    @property
    def mean(self) -> float:
        return self._mean

    @property
    def highest(self) -> float:
        return float(self._sorted[-1])

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        return np.searchsorted(self._sorted, delay, side="right") / len(self.samples)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        size = len(self.samples)
        place = np.ceil(np.asarray(level) * size).astype(np.int64) - 1
        return self._sorted[np.clip(place, 0, size - 1)]

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        return self._sorted[generator.integers(len(self.samples), size=shape)]

    def to_dict(self) -> dict[str, Any]:
        return {"law": self.law, "samples": list(self.samples)}

    @cached_property
    def _sorted(self) -> np.ndarray:
        return np.sort(np.array(self.samples))

    @cached_property
    def _mean(self) -> float:
        return math.fsum(self.samples) / len(self.samples)

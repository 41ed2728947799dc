"""Delay laws: how long a computation or a message takes."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtr, ndtri


class DelayError(ValueError):
    """A delay is negative, not a number, or badly described."""


class Delay(ABC):
    """A distribution over delays [s], never negative.

    Two laws are equal when their parameters are; `to_dict` and `make_delay` carry them through YAML.
    """

    law: ClassVar[str]

    @property
    @abstractmethod
    def mean(self) -> float:
        """Expected delay [s]."""

    @property
    @abstractmethod
    def highest(self) -> float:
        """Bound that no draw exceeds [s]."""

    @abstractmethod
    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Draw independent delays.

        Returns:
            Array of `shape`, float64 [s].
        """

    @property
    def constant(self) -> bool:
        """Whether every draw is the same."""
        return False

    def to_dict(self) -> dict[str, Any]:
        """Describe the law in plain numbers, strings and lists."""
        return {"law": self.law} | asdict(self)  # type: ignore[call-overload]


@dataclass(frozen=True)
class Deterministic(Delay):
    """Always `value` [s]."""

    value: float
    law = "deterministic"

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", _seconds("value", self.value))

    @property
    def mean(self) -> float:
        return self.value

    @property
    def highest(self) -> float:
        return self.value

    @property
    def constant(self) -> bool:
        return True

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        return np.full(shape, self.value)


@dataclass(frozen=True)
class Gaussian(Delay):
    """Normal distribution with location `loc` and scale `scale` [s], truncated at 0.

    The truncated density is that of N(loc, scale^2) given delay >= 0; `mean` is that of the truncated law.
    """

    loc: float
    scale: float
    law = "gaussian"

    def __post_init__(self) -> None:
        object.__setattr__(self, "loc", _seconds("loc", self.loc))
        object.__setattr__(self, "scale", _seconds("scale", self.scale))

    @property
    def constant(self) -> bool:
        return self.scale == 0.0

    @property
    def mean(self) -> float:
        if self.scale == 0.0:
            return self.loc
        # Mean of a lower-truncated normal: loc + scale pdf(a) / (1 - cdf(a)) with a = -loc / scale.
        a = -self.loc / self.scale
        return self.loc + self.scale * math.exp(-0.5 * a * a) / math.sqrt(2 * math.pi) / float(ndtr(-a))

    @property
    def highest(self) -> float:
        if self.scale == 0.0:
            return self.loc
        # The smallest tail that `sample` can draw: uniforms are multiples of 2^-53.
        return self.loc - self.scale * float(ndtri(ndtr(self.loc / self.scale) * 2.0**-53))

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        if self.scale == 0.0:
            return np.full(shape, self.loc)
        # Inverse transform on the upper tail: no rejection, one uniform a draw.
        tail = float(ndtr(self.loc / self.scale)) * (1.0 - generator.random(shape))
        return np.maximum(self.loc - self.scale * ndtri(tail), 0.0)


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

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        chosen = generator.choice(len(self.components), size=shape, p=self.weights)
        draws = np.stack([law.sample(generator, shape) for law in self.components])
        return np.take_along_axis(draws, chosen[None], axis=0)[0]

    def to_dict(self) -> dict[str, Any]:
        components = [law.to_dict() for law in self.components]
        return {"law": self.law, "components": components, "weights": list(self.weights)}


@dataclass(frozen=True)
class Empirical(Delay):
    """Draws with replacement from measured delays [s]."""

    samples: tuple[float, ...]
    law = "empirical"

    def __post_init__(self) -> None:
        samples = tuple(_seconds("samples", sample) for sample in np.ravel(np.asarray(self.samples)).tolist())
        if not samples:
            raise DelayError("empirical: no samples given")
        object.__setattr__(self, "samples", samples)

    @property
    def mean(self) -> float:
        return math.fsum(self.samples) / len(self.samples)

    @property
    def highest(self) -> float:
        return max(self.samples)

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        return np.asarray(self.samples)[generator.integers(len(self.samples), size=shape)]

    def to_dict(self) -> dict[str, Any]:
        return {"law": self.law, "samples": list(self.samples)}


LAWS: dict[str, type[Delay]] = {law.law: law for law in (Deterministic, Gaussian, Mixture, Empirical)}


def make_delay(spec: "Delay | float | Mapping[str, Any]") -> Delay:
    """Build a delay law from a number of seconds, a description (see `Delay.to_dict`) or a law.

    Raises:
        DelayError: the description names no known law, or its numbers are no delay.
    """
    if isinstance(spec, Delay):
        return spec
    if isinstance(spec, Mapping):
        options = dict(spec)
        name = options.pop("law", None)
        if name not in LAWS:
            raise DelayError(f'delay law "{name}" is not known; known: {", ".join(LAWS)}')
        try:
            return LAWS[name](**options)
        except TypeError as error:
            raise DelayError(f"{name}: {error}") from error
    return Deterministic(spec)


def exact_seconds(law: Delay) -> Fraction:
    """Return the expected delay as a rational: a constant as the fraction it was meant as, else to 1 ns.

    The float 1/60 becomes the rational 1/60, so that a delay of one period meets the tick exactly.
    """
    return exact_fraction(law.mean) if law.constant else Fraction(round(law.mean * 10**9), 10**9)


def exact_fraction(value: float | Fraction) -> Fraction:
    """Return the simple fraction that rounds to the float `value`, if there is one, else the float itself."""
    simple = Fraction(value).limit_denominator(10**6)
    return simple if float(simple) == float(value) else Fraction(round(Fraction(value) * 10**9), 10**9)


def _seconds(name: str, value: Any) -> float:
    try:
        seconds = float(value)
    except (TypeError, ValueError) as error:
        raise DelayError(f"{name}: {value!r} is no number of seconds") from error
    if not math.isfinite(seconds) or seconds < 0.0:
        raise DelayError(f"{name}: {seconds} s is no delay; give a finite number of seconds >= 0")
    return seconds

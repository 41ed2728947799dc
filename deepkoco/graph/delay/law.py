"""What a delay law is, how laws are told apart and described, and exact fractions of a second."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, fields
from fractions import Fraction
from functools import lru_cache
from typing import Any, ClassVar, TypeVar

import numpy as np


class DelayError(ValueError):
    """A delay is negative, not a number, or badly described."""


LARGEST_LEVEL = 1.0 - 2.0**-53
"""Uniform draws are multiples of 2^-53 below 1: no law is asked for a quantile beyond this one."""


class Delay(ABC):
    """A distribution over delays [s], never negative.

    Two laws are equal when their parameters are; `to_dict` and `make_delay` carry them through YAML.
    """

    law: ClassVar[str]

    timed: ClassVar[bool] = False
    """Whether the delay depends on the time at which it starts."""

    @property
    @abstractmethod
    def mean(self) -> float:
        """Expected delay [s]."""

    @property
    @abstractmethod
    def highest(self) -> float:
        """Bound that no draw exceeds [s]."""

    @property
    def constant(self) -> bool:
        """Whether every draw is the same."""
        return False

    @property
    def loses(self) -> bool:
        """Whether a draw can be infinite: a message that never arrives."""
        return False

    @property
    def marginal(self) -> "Delay":
        """Law of a single draw, without what ties it to those before."""
        return self

    def autocorrelation(self, period: float) -> float:
        """Return the correlation of the normal scores of two draws that are `period` [s] apart."""
        return 0.0

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        """Return the probability of at most `delay` [s]."""
        raise DelayError(f"{self.law}: this law has no distribution function")

    def quantile(self, level: np.ndarray) -> np.ndarray:
        """Return the smallest delay [s] that is not exceeded with probability `level`."""
        raise DelayError(f"{self.law}: this law has no quantiles, so it cannot be correlated")

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Draw independent delays.

        Returns:
            Array of `shape`, float64 [s].
        """
        return self.quantile(generator.random(shape))

    def stream(self, rows: int, period: float, start: float = 0.0) -> "Stream":
        """Return what draws the delays of successive steps or messages.

        Args:
            rows: number of sequences, independent of each other.
            period: time between two draws of a sequence [s], as far as it is known.
            start: time of the first draw [s], as far as it is known.
        """
        return Stream(self, rows)

    def to_dict(self) -> dict[str, Any]:
        """Describe the law in plain numbers, strings and lists."""
        return {"law": self.law} | asdict(self)  # type: ignore[call-overload]


class Stream:
    """Draws of one law in succession; here they are independent, other laws remember what they drew."""

    def __init__(self, law: Delay, rows: int) -> None:
        self.law = law
        self.rows = rows

    def draw(self, generator: np.random.Generator, columns: int) -> np.ndarray:
        """Return the next `columns` delays of every sequence, (rows, columns) float64 [s]."""
        return self.law.sample(generator, (self.rows, columns))


LAWS: dict[str, type[Delay]] = {}
Law = TypeVar("Law", bound=type[Delay])


def register(law: Law) -> Law:
    """Make a law known to `make_delay` under its name."""
    LAWS[law.law] = law
    return law


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
        if not isinstance(name, str) or name not in LAWS:
            raise DelayError(f'delay law "{name}" is not known; known: {", ".join(sorted(LAWS))}')
        known = [field.name for field in fields(LAWS[name]) if field.init]  # pyright: ignore[reportArgumentType]
        if strange := [option for option in options if option not in known]:
            raise DelayError(f'{name}: there is no "{strange[0]}"; it takes {", ".join(known)}')
        try:
            return LAWS[name](**options)
        except TypeError as error:
            raise DelayError(f"{name}: {error}") from error
    return LAWS["deterministic"](spec)  # pyright: ignore[reportCallIssue]


def exact_seconds(law: Delay) -> Fraction:
    """Return the expected delay as a rational: a constant as the fraction it was meant as, else to 1 ns.

    The float 1/60 becomes the rational 1/60, so that a delay of one period meets the tick exactly.
    """
    return exact_fraction(law.mean) if law.constant else Fraction(round(law.mean * 10**9), 10**9)


@lru_cache(maxsize=4096)
def exact_fraction(value: float | Fraction) -> Fraction:
    """Return the simple fraction that rounds to the float `value`, if there is one, else the float itself."""
    simple = Fraction(value).limit_denominator(10**6)
    return simple if float(simple) == float(value) else Fraction(round(Fraction(value) * 10**9), 10**9)


def seconds(name: str, value: Any) -> float:
    """Return `value` as a number of seconds that can be a delay."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise DelayError(f"{name}: {str(value)[:80]!r} is no number of seconds") from error
    if isinstance(value, bool):
        raise DelayError(f"{name}: {value} is no number of seconds")
    if not math.isfinite(number) or number < 0.0:
        raise DelayError(f"{name}: {number} s is no delay; give a finite number of seconds >= 0")
    return number


def between(name: str, value: Any, low: float, high: float, closed: bool = True) -> float:
    """Return `value` as a number from `low` to `high`, the end `high` itself only if `closed`."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise DelayError(f"{name}: {value!r} is no number") from error
    if not (low <= number < high or (closed and number == high)):
        raise DelayError(f"{name}: {number} is not in [{low}, {high}{']' if closed else ')'}")
    return number

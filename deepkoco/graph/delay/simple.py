"""Laws with a formula: deterministic, uniform, truncated Gaussian, log-normal and gamma."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc, gammaincinv, ndtr, ndtri

from deepkoco.graph.delay.law import LARGEST_LEVEL, Delay, DelayError, between, register, seconds


@register
@dataclass(frozen=True)
class Deterministic(Delay):
    """Always `value` [s]."""

    value: float
    law = "deterministic"

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", seconds("value", self.value))

    @property
    def mean(self) -> float:
        return self.value

    @property
    def highest(self) -> float:
        return self.value

    @property
    def constant(self) -> bool:
        return True

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        return (np.asarray(delay) >= self.value).astype(np.float64)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.value, np.shape(level)).astype(np.float64)

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        return np.full(shape, self.value)


@register
@dataclass(frozen=True)
class Uniform(Delay):
    """Uniform distribution from `low` to `high` [s]."""

    low: float
    high: float
    law = "uniform"

    def __post_init__(self) -> None:
        object.__setattr__(self, "low", seconds("low", self.low))
        object.__setattr__(self, "high", seconds("high", self.high))
        if self.high < self.low:
            raise DelayError(f"uniform: high {self.high} s is below low {self.low} s")

    @property
    def constant(self) -> bool:
        return self.low == self.high

    @property
    def mean(self) -> float:
        return self.low + 0.5 * (self.high - self.low)

    @property
    def highest(self) -> float:
        return self.high

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        if self.constant:
            return (np.asarray(delay) >= self.low).astype(np.float64)
        with np.errstate(over="ignore"):
            return np.clip((np.asarray(delay) - self.low) / (self.high - self.low), 0.0, 1.0)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        return np.minimum(self.low + (self.high - self.low) * np.asarray(level), self.high)


@register
@dataclass(frozen=True)
class Gaussian(Delay):
    """Normal distribution with location `loc` and scale `scale` [s], truncated at 0.

    The truncated density is that of N(loc, scale^2) given delay >= 0; `mean` is that of the truncated law.
    """

    loc: float
    scale: float
    law = "gaussian"

    def __post_init__(self) -> None:
        object.__setattr__(self, "loc", seconds("loc", self.loc))
        object.__setattr__(self, "scale", seconds("scale", self.scale))

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
        return self.loc if self.scale == 0.0 else float(self.quantile(np.array(LARGEST_LEVEL)))

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        delay = np.asarray(delay)
        if self.scale == 0.0:
            return (delay >= self.loc).astype(np.float64)
        # Through the upper tails, which keep their digits where the distribution function is near 1.
        with np.errstate(over="ignore"):
            tail = ndtr((self.loc - delay) / self.scale) / ndtr(self.loc / self.scale)
        return np.where(delay < 0.0, 0.0, 1.0 - tail)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        scale = np.asarray(self.scale)
        safe = np.where(scale == 0.0, 1.0, scale)  # of a batch of laws some may be constant
        with np.errstate(over="ignore"):
            tail = ndtr(self.loc / safe) * (1.0 - np.asarray(level))
        return np.where(scale == 0.0, self.loc, np.maximum(self.loc - scale * ndtri(tail), 0.0))


@register
@dataclass(frozen=True)
class LogNormal(Delay):
    """offset + median exp(sigma nu) [s] with nu standard normal."""

    median: float
    sigma: float
    offset: float = 0.0
    law = "lognormal"

    def __post_init__(self) -> None:
        object.__setattr__(self, "median", seconds("median", self.median))
        object.__setattr__(self, "sigma", between("lognormal: sigma", self.sigma, 0.0, 10.0))
        object.__setattr__(self, "offset", seconds("offset", self.offset))

    @property
    def constant(self) -> bool:
        return self.sigma == 0.0 or self.median == 0.0

    @property
    def mean(self) -> float:
        return self.offset + self.median * math.exp(0.5 * self.sigma**2)

    @property
    def highest(self) -> float:
        return float(self.quantile(np.array(LARGEST_LEVEL)))

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        above = np.asarray(delay, dtype=np.float64) - self.offset
        if self.constant:
            return (above >= self.median).astype(np.float64)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            score = np.log(above / self.median) / self.sigma
        return np.where(above > 0.0, ndtr(score), 0.0)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        # Level 0 is the score -inf; of a batch of laws some may have no spread, and 0 times inf is no number.
        score = np.maximum(ndtri(np.asarray(level)), -40.0)
        return self.offset + self.median * np.exp(self.sigma * score)


@register
@dataclass(frozen=True)
class Gamma(Delay):
    """offset [s] plus a gamma distribution with shape `shape` and scale `scale` [s]."""

    shape: float
    scale: float
    offset: float = 0.0
    law = "gamma"

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", between("gamma: shape", self.shape, 1e-3, 1e9))
        object.__setattr__(self, "scale", seconds("scale", self.scale))
        object.__setattr__(self, "offset", seconds("offset", self.offset))

    @property
    def constant(self) -> bool:
        return self.scale == 0.0

    @property
    def mean(self) -> float:
        return self.offset + self.shape * self.scale

    @property
    def highest(self) -> float:
        return float(self.quantile(np.array(LARGEST_LEVEL)))

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        above = np.asarray(delay, dtype=np.float64) - self.offset
        if self.scale == 0.0:
            return (above >= 0.0).astype(np.float64)
        return gammainc(self.shape, np.maximum(above, 0.0) / self.scale)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        return self.offset + self.scale * gammaincinv(self.shape, np.minimum(level, LARGEST_LEVEL))

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        # Rejection sampling is ten times as fast as quantiles; both have the same law.
        draws = self.offset + self.scale * generator.standard_gamma(self.shape, shape)
        return np.minimum(draws, self.quantile(np.array(LARGEST_LEVEL)))

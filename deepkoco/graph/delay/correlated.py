"""Laws whose draws remember those before: autoregressive, Ornstein-Uhlenbeck, and growing overruns.

A normal score z_k follows the autoregression and the marginal's quantile function turns it into a delay
(a Gaussian copula): every single draw has exactly the marginal law, whatever that is.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy.special import ndtr

from deepkoco.graph.delay.law import (
    LARGEST_LEVEL,
    Delay,
    DelayError,
    Stream,
    between,
    make_delay,
    register,
    seconds,
)

_WIDEST = 8.3  # no draw of an overrun process is further out, in standard deviations


class CopulaDelay(Delay):
    """A law whose single draws are those of `delay` and whose normal scores are autoregressive."""

    delay: Delay

    @property
    def mean(self) -> float:
        return self.delay.mean

    @property
    def highest(self) -> float:
        return self.delay.highest

    @property
    def constant(self) -> bool:
        return self.delay.constant

    @property
    def marginal(self) -> Delay:
        return self.delay

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        return self.delay.cdf(delay)

    def quantile(self, level: np.ndarray) -> np.ndarray:
        return self.delay.quantile(level)

    def stream(self, rows: int, period: float, start: float = 0.0) -> Stream:
        return CopulaStream(self, rows, period)


@register
@dataclass(frozen=True)
class Autoregressive(CopulaDelay):
    """Delays with law `delay` whose normal scores have correlation `correlation` from one to the next.

    z_k = a z_{k-1} + sqrt(1 - a^2) nu_k with a = `correlation`; delay_k = F^-1(Phi(z_k)).
    """

    delay: Delay
    correlation: float
    law = "autoregressive"

    def __post_init__(self) -> None:
        object.__setattr__(self, "delay", _plain(self.law, self.delay))
        object.__setattr__(
            self, "correlation", between("autoregressive: correlation", self.correlation, -0.9999, 0.9999)
        )

    def autocorrelation(self, period: float) -> float:
        return self.correlation

    def to_dict(self) -> dict[str, Any]:
        return {"law": self.law, "delay": self.delay.to_dict(), "correlation": self.correlation}


@register
@dataclass(frozen=True)
class OrnsteinUhlenbeck(CopulaDelay):
    """Delays with law `delay` whose normal scores forget with time constant `time_constant` [s].

    The scores are an Ornstein-Uhlenbeck process seen once a period T: correlation exp(-T / time_constant).
    """

    delay: Delay
    time_constant: float
    law = "ornstein_uhlenbeck"

    def __post_init__(self) -> None:
        object.__setattr__(self, "delay", _plain(self.law, self.delay))
        object.__setattr__(self, "time_constant", seconds("time_constant", self.time_constant))
        if self.time_constant == 0.0:
            raise DelayError("ornstein_uhlenbeck: time_constant 0 s is no correlation; give the delay alone")

    def autocorrelation(self, period: float) -> float:
        return math.exp(-period / self.time_constant)

    def to_dict(self) -> dict[str, Any]:
        return {"law": self.law, "delay": self.delay.to_dict(), "time_constant": self.time_constant}


class CopulaStream(Stream):
    """Autoregressive normal scores, turned into delays by the marginal law."""

    def __init__(self, law: Delay, rows: int, period: float) -> None:
        super().__init__(law, rows)
        self.factor = law.autocorrelation(period)
        self._last: np.ndarray | None = None

    def draw(self, generator: np.random.Generator, columns: int) -> np.ndarray:
        return self.from_noise(generator.standard_normal((self.rows, columns)))

    def from_noise(self, noise: np.ndarray) -> np.ndarray:
        """Return the next delays, given standard normal innovations (rows, columns)."""
        if self.factor != 0.0 and noise.shape[1]:
            if self._last is None:
                # The first score is drawn from the stationary law, not from an arbitrary start.
                self._last = np.zeros(self.rows)
                stationary = noise[:, 0] / math.sqrt(1.0 - self.factor**2)
                noise = np.concatenate([stationary[:, None], noise[:, 1:]], axis=1)
            noise = autoregress(noise, self.factor, math.sqrt(1.0 - self.factor**2), self._last)
        return self.law.quantile(np.minimum(ndtr(noise), LARGEST_LEVEL))


@njit(cache=True)
def autoregress(noise, factor, gain, last):
    """Return x_k = factor x_{k-1} + gain noise_k along the columns; `last` holds x before and after."""
    result = np.empty_like(noise)
    for row in range(noise.shape[0]):
        x = last[row]
        for k in range(noise.shape[1]):
            x = factor * x + gain * noise[row, k]
            result[row, k] = x
        last[row] = x
    return result


@register
@dataclass(frozen=True)
class OverrunProcess(Delay):
    """Computation that takes a period and at times more: period max(1, 1 + x_k) [s].

    x_k = (1 - theta) x_{k-1} + sigma nu_k with nu standard normal and x_{-1} = 0. A node with FREQUENCY
    scheduling and this delay starts a step every period max(1, 1 + x_k): the process with which the
    supergraph search is evaluated. `mean` is that of the stationary process.

    Source: thesis Eq. 3.2, in the reading that gives the drift that its text describes.
    """

    period: float
    sigma: float
    theta: float = 0.07
    law = "overrun_process"

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", seconds("period", self.period))
        object.__setattr__(self, "sigma", between("overrun_process: sigma", self.sigma, 0.0, 10.0))
        object.__setattr__(self, "theta", between("overrun_process: theta", self.theta, 1e-4, 1.0))

    @property
    def deviation(self) -> float:
        """Standard deviation of the stationary x_k."""
        return self.sigma / math.sqrt(1.0 - (1.0 - self.theta) ** 2)

    @property
    def mean(self) -> float:
        return self.period * (1.0 + self.deviation / math.sqrt(2.0 * math.pi))

    @property
    def highest(self) -> float:
        return self.period * (1.0 + _WIDEST * self.deviation)

    @property
    def constant(self) -> bool:
        return self.sigma == 0.0 or self.period == 0.0

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Draw from the stationary law."""
        return self.delays(self.deviation * generator.standard_normal(shape))

    def stream(self, rows: int, period: float, start: float = 0.0) -> "Stream":
        return _OverrunStream(self, rows)

    def delays(self, x: np.ndarray) -> np.ndarray:
        """Return period max(1, 1 + x) [s]."""
        return self.period * (1.0 + np.clip(x, 0.0, _WIDEST * self.deviation))


class _OverrunStream(Stream):
    """Overruns that start from x = 0."""

    def __init__(self, law: OverrunProcess, rows: int) -> None:
        super().__init__(law, rows)
        self._process = law
        self._last = np.zeros(rows)

    def draw(self, generator: np.random.Generator, columns: int) -> np.ndarray:
        noise = generator.standard_normal((self.rows, columns))
        law = self._process
        return law.delays(autoregress(noise, 1.0 - law.theta, law.sigma, self._last))


def _plain(law: str, delay: Any) -> Delay:
    delay = make_delay(delay)
    if delay.loses:
        raise DelayError(f"{law}: put {law} into lossy, not lossy into {law}")
    if delay.timed:
        raise DelayError(f"{law}: its delay depends on the time, not on the one before")
    if delay.marginal is not delay or isinstance(delay, OverrunProcess):
        raise DelayError(f"{law}: its delay is correlated already")
    return delay

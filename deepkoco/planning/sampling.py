"""Planning by samples of action sequences on any model that says what they cost: CEM and MPPI."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Costs = Callable[[Array], Array]
"""From action sequences (E, S, H, M) to their costs (E, S); not finite: not to be taken."""


@dataclass(frozen=True)
class SamplingConfig:
    r"""How sequences are drawn and weighed.

    Attributes:
        method: "cem" or "mppi".
        horizon: Actions of a sequence, H.
        samples: Sequences of an iteration, S.
        iterations: Of a decision.
        spread: Standard deviation of the noise, as a share of half of the actions' range.
        correlation: Of the noise from one action to the next, in [0, 1).
        elites: Of CEM, how many of the samples the next mean and spread are made of.
        temperature: Of MPPI: $\lambda$ as a share of the standard deviation of the samples' costs.
        least_spread: Of CEM, below which its spread does not fall, like `spread`.
    """

    method: str = "mppi"
    horizon: int = 12
    samples: int = 32
    iterations: int = 1
    spread: float = 0.6
    correlation: float = 0.7
    elites: int = 6
    temperature: float = 0.3
    least_spread: float = 0.1

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f'method "{self.method}" is none of {", ".join(METHODS)}')
        for name in ("horizon", "iterations", "elites"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}; give 1 or more")
        if self.samples < max(3, self.elites):
            raise ValueError(f"samples = {self.samples}; give 3 or more, and as many as elites")
        for name in ("spread", "temperature", "least_spread"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)}; give a number above 0")
        if not 0.0 <= self.correlation < 1.0:
            raise ValueError(f"correlation = {self.correlation}; give a number from 0 to below 1")


class SamplingPlanner:
    r"""Decides for E control loops at once, each with a plan of its own.

    Every decision begins at the mean of the one before, moved on by one step. Each of its iterations draws S sequences
    $a = \mu + \sigma \epsilon$ around the mean, cut to the range; the first is the mean itself, the second stands
    still. $\epsilon$ is stationary, first-order autoregressive noise. Then

    - MPPI: $\mu = \sum_s w_s a_s$ with $w_s \propto \exp(-(c_s - \min c) / \lambda)$. With $\lambda$ a share of the
      costs' standard deviation it needs no other tuning where distances become small.
    - CEM: $\mu$ and $\sigma$ are mean and standard deviation of the elites.

    The plan is the last mean.

    Source: Williams et al., Information theoretic MPC for model-based reinforcement learning, ICRA 2017; Rubinstein,
    The cross-entropy method for combinatorial and continuous optimization, 1999.

    Args:
        config: See there.
        loops: Control loops E.
        low, high: Ranges (M,) of the actions.
        generator: Draws the noise.
    """

    def __init__(
        self, config: SamplingConfig, loops: int, low: Array, high: Array, generator: np.random.Generator
    ) -> None:
        self.config, self._generator = config, generator
        self._low, self._high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        self._middle, self._half = 0.5 * (self._low + self._high), 0.5 * (self._high - self._low)
        self._shape = (loops, config.horizon, len(self._low))
        self.reset()

    def reset(self) -> None:
        """Forget the plans; the generator goes on."""
        self.plan = np.broadcast_to(self._middle, self._shape).copy()
        """The plans (E, H, M) of the last decision."""
        self._fresh = True

    def decide(self, costs: Costs) -> Array:
        """The next action (E, M) of each loop.

        Args:
            costs: Of action sequences that begin with the action to be decided.
        """
        config = self.config
        mean = (
            self.plan if self._fresh else np.concatenate([self.plan[:, 1:], self.plan[:, -1:]], 1)
        )  # (E, H, M)
        spread = np.broadcast_to(config.spread * self._half, mean.shape)
        for _ in range(config.iterations):
            noise = self._noise()
            plans = mean[:, None] + spread[:, None] * noise
            plans[:, 0], plans[:, 1] = mean, self._middle
            plans = np.minimum(np.maximum(plans, self._low), self._high)
            found = np.asarray(costs(plans), np.float64)
            found = np.where(np.isfinite(found), found, np.inf)
            mean, spread = METHODS[config.method](self, plans, found, mean, spread)
        self.plan, self._fresh = mean, False
        return mean[:, 0].copy()

    def _noise(self) -> Array:
        """Noise (E, S, H, M) of standard deviation 1."""
        loops, horizon, width = self._shape
        rho = self.config.correlation
        white = self._generator.standard_normal((horizon, loops, self.config.samples, width))
        noise = np.empty_like(white)
        noise[0] = white[0]
        for k in range(1, horizon):
            noise[k] = rho * noise[k - 1] + np.sqrt(1.0 - rho * rho) * white[k]
        return np.moveaxis(noise, 0, 2)

    def _mppi(self, plans: Array, costs: Array, mean: Array, spread: Array) -> tuple[Array, Array]:
        known = np.asarray(np.isfinite(costs))
        usable = np.asarray(known.any(1))
        filled = np.where(known, costs, 0.0)
        count = known.sum(1, keepdims=True).clip(1)
        average = filled.sum(1, keepdims=True) / count
        deviation = np.sqrt((np.where(known, costs - average, 0.0) ** 2).sum(1, keepdims=True) / count)
        least = np.where(known, costs, np.inf).min(1, keepdims=True)
        over = np.where(known, costs - np.where(usable[:, None], least, 0.0), np.inf)
        weights = np.exp(-over / (self.config.temperature * deviation + 1e-12))
        weights /= weights.sum(1, keepdims=True).clip(1e-300)
        after = np.einsum("es,eshm->ehm", weights, plans)
        return np.where(usable[:, None, None], after, mean), spread

    def _cem(self, plans: Array, costs: Array, mean: Array, spread: Array) -> tuple[Array, Array]:
        order = np.argsort(costs, 1, kind="stable")[:, : self.config.elites]
        known = np.asarray(np.isfinite(np.take_along_axis(costs, order, 1)))
        usable = np.asarray(known.all(1))
        elites = np.take_along_axis(plans, order[:, :, None, None], 1)
        least = self.config.least_spread * self._half
        after = elites.mean(1), np.maximum(elites.std(1), least)
        chosen = usable[:, None, None]
        return np.where(chosen, after[0], mean), np.where(chosen, after[1], spread)


METHODS = {"mppi": SamplingPlanner._mppi, "cem": SamplingPlanner._cem}

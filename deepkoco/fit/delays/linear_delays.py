"""Posterior, marginal likelihood and mixture law of delays in which the residuals are linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepkoco.graph.episodes.fitting.mixture_fit import expectation_maximisation

SMALLEST_SPREAD = 2e-5  # smallest standard deviation of a component [s]
SWEEPS, WARM_UP = 400, 100


@dataclass(frozen=True)
class LinearDelays:
    """Likelihood of the messages' delays eps in each window: exp(-eps' A eps / 2 + h' eps)."""

    members: Sequence[np.ndarray]  # per window, indices of its messages
    information: Sequence[np.ndarray]  # A
    pull: Sequence[np.ndarray]  # h

    def posterior(self, mean: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Posterior means and standard deviations under independent normal priors (K,)."""
        centre, spread = mean.copy(), sd.copy()
        for own, a, h in zip(self.members, self.information, self.pull, strict=True):
            covariance = np.linalg.inv(a + np.diag(sd[own] ** -2))
            centre[own] = covariance @ (h + mean[own] / sd[own] ** 2)
            spread[own] = np.sqrt(np.diag(covariance))
        return centre, spread

    def draw(self, mean: np.ndarray, sd: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """One draw (K,) of the delays under independent normal priors."""
        result = mean + sd * generator.standard_normal(len(mean))
        for own, a, h in zip(self.members, self.information, self.pull, strict=True):
            root = np.linalg.cholesky(a + np.diag(sd[own] ** -2))
            white = np.linalg.solve(root, h + mean[own] / sd[own] ** 2) + generator.standard_normal(len(own))
            result[own] = np.linalg.solve(root.T, white)
        return result

    def log_marginal(self, mean: float, sd: float) -> float:
        """Log marginal likelihood of one normal law, up to a constant."""
        total = 0.0
        for a, h in zip(self.information, self.pull, strict=True):
            # With eps = mean + sd z, z is standard normal.
            ones = np.full(len(a), mean)
            left = h - a @ ones
            inner = np.eye(len(a)) + sd**2 * a
            total += float(ones @ h - 0.5 * ones @ a @ ones)
            total += 0.5 * sd**2 * float(left @ np.linalg.solve(inner, left))
            total -= 0.5 * float(np.linalg.slogdet(inner)[1])
        return total


@dataclass(frozen=True)
class MixtureLaw:
    """Normal mixture of the delays, and the posterior of each message's delay under it.

    Attributes:
        means: (C,) means of the components [s].
        spreads: (C,) their standard deviations [s].
        weights: (C,) their shares.
        centre: (K,) posterior means of the messages' delays [s].
        sd: (K,) their posterior standard deviations [s].
    """

    means: np.ndarray
    spreads: np.ndarray
    weights: np.ndarray
    centre: np.ndarray
    sd: np.ndarray


def mixture_law(
    linear: LinearDelays, start: np.ndarray | MixtureLaw, components: int, generator: np.random.Generator
) -> MixtureLaw:
    """Fit a normal mixture to the delays by stochastic-approximation EM.

    A sweep first draws component and delay of each message together, given the delays of the others. If the component
    were drawn given the delay, a message would not leave a narrow component. The sweep then draws all delays of a
    window together, given the components.

    Args:
        linear: Likelihood of the delays.
        start: A law to start from, or (K,) approximate delays [s].
        components: Number of components.
        generator: Generator of all draws.

    Source: Delyon, Lavielle, Moulines, Convergence of a stochastic approximation version of the EM algorithm (1999).
    """
    if isinstance(start, MixtureLaw):
        means, spreads, weights, eps = start.means, start.spreads, start.weights, start.centre.copy()
    else:
        order = np.sort(start)
        weights, means, spreads = expectation_maximisation(order, np.ones(len(order)), components)
        spreads, eps = np.maximum(spreads, 2 * SMALLEST_SPREAD), start.copy()
    least = 0.1 * float(np.min(spreads))
    single = _SingleMessageGibbs(linear)
    held: np.ndarray | None = None
    total, square, kept = np.zeros(len(eps)), np.zeros(len(eps)), 0
    for sweep in range(SWEEPS):
        eps, label = single.draw(eps, means, spreads, weights, generator)
        eps = linear.draw(means[label], spreads[label], generator)
        one = np.eye(components)[label]
        now = np.stack([one.sum(0), one.T @ eps, one.T @ eps**2])
        gain = 1.0 if sweep < WARM_UP else (sweep - WARM_UP + 1.0) ** -0.7
        held = now if held is None else held + gain * (now - held)
        size = held[0] + 1e-9
        weights = (size + 1.0) / (size + 1.0).sum()
        means = np.where(size > 0.5, held[1] / size, means)
        variance = held[2] / size - means**2
        # Without this inverse-gamma prior of weight one, the spread of a component with one message goes to 0.
        spreads = np.sqrt(np.maximum((size * variance + least**2) / (size + 1.0), SMALLEST_SPREAD**2))
        if sweep >= WARM_UP:
            total, square, kept = total + eps, square + eps**2, kept + 1
    centre = total / kept
    return MixtureLaw(means, spreads, weights, centre, np.sqrt((square / kept - centre**2).clip(0.0)))


class _SingleMessageGibbs:
    """Gibbs draws of single messages given the others. The j-th messages of all windows are drawn at once."""

    def __init__(self, linear: LinearDelays) -> None:
        most = max(len(own) for own in linear.members)
        shape = (len(linear.members), most)
        self.index = np.full(shape, -1)
        self.information, self.pull = np.zeros((*shape, most)), np.zeros(shape)
        for w, (own, a, h) in enumerate(zip(linear.members, linear.information, linear.pull, strict=True)):
            self.index[w, : len(own)] = own
            self.information[w, : len(own), : len(own)], self.pull[w, : len(own)] = a, h

    def draw(
        self,
        eps: np.ndarray,
        means: np.ndarray,
        spreads: np.ndarray,
        weights: np.ndarray,
        generator: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw each message once; returns delays (K,) [s] and components (K,)."""
        there = self.index >= 0
        now = np.where(there, eps[self.index], 0.0)
        labels = np.zeros(self.index.shape, dtype=int)
        for j in range(self.index.shape[1]):
            own = self.information[:, j, j]
            # Density of one message: exp(-own eps^2 / 2 + pull eps), times the law.
            pull = self.pull[:, j] - (self.information[:, j] * now).sum(1) + own * now[:, j]
            precision = own[:, None] + spreads**-2
            centre = (pull[:, None] + means / spreads**2) / precision
            score = np.log(weights / spreads) - 0.5 * np.log(precision)
            score = score + 0.5 * (precision * centre**2 - (means / spreads) ** 2)
            share = np.exp(score - score.max(1, keepdims=True)).cumsum(1)
            label = (generator.random((len(share), 1)) * share[:, -1:] > share[:, :-1]).sum(1)
            row = np.arange(len(label))
            noise = generator.standard_normal(len(label)) / np.sqrt(precision[row, label])
            now[:, j] = np.where(there[:, j], centre[row, label] + noise, 0.0)
            labels[:, j] = label
        result, label = eps.copy(), np.zeros(len(eps), dtype=int)
        result[self.index[there]], label[self.index[there]] = now[there], labels[there]
        return result, label

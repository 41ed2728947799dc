"""Posterior, marginal likelihood and mixture law of delays in which the residuals are linear."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepkoco.graph.episodes.fitting.mixture_fit import expectation_maximisation

SMALLEST_SPREAD = 2e-5  # smallest standard deviation of a component [s]
SWEEPS, WARM_UP = 200, 60


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

    Gibbs sampling draws the component of each message; the delays are integrated out in closed form. A sampler that
    also draws the delays cannot leave the first assignment that fits. Neighbouring messages explain one motion
    together, so a message could not change its component while their delays are fixed. With the delays integrated
    out, the result is independent of the start.

    Args:
        linear: Likelihood of the delays; every message acts in one window.
        start: A law to start from, or (K,) approximate delays [s].
        components: Number of components.
        generator: Generator of all draws.

    Source: Delyon, Lavielle, Moulines, Convergence of a stochastic approximation version of the EM algorithm (1999);
        Liu, The collapsed Gibbs sampler in Bayesian computations (1994).
    """
    if isinstance(start, MixtureLaw):
        means, spreads, weights, eps = start.means, start.spreads, start.weights, start.centre
    else:
        order = np.sort(start)
        weights, means, spreads = expectation_maximisation(order, np.ones(len(order)), components)
        spreads, eps = np.maximum(spreads, 2 * SMALLEST_SPREAD), start
    least = 0.1 * float(np.min(spreads))
    labels = (np.log(weights / spreads) - 0.5 * ((eps[:, None] - means) / spreads) ** 2).argmax(1)
    components_of = _Components(linear, labels)
    held = np.zeros((3, components))
    total, square = np.zeros(len(eps)), np.zeros(len(eps))
    for sweep in range(SWEEPS):
        one, centre, variance = components_of.draw(means, spreads, weights, generator)
        now = np.stack([one.sum(0), one.T @ centre, one.T @ (centre**2 + variance)])
        gain = 1.0 if sweep < WARM_UP else (sweep - WARM_UP + 1.0) ** -0.7
        held = held + gain * (now - held)
        size = held[0] + 1e-9
        weights = (size + 1.0) / (size + 1.0).sum()
        means = np.where(size > 0.5, held[1] / size, means)
        spread = held[2] / size - means**2
        # Without this inverse-gamma prior of weight one, the spread of a component with one message goes to 0.
        spreads = np.sqrt(np.maximum((size * spread + least**2) / (size + 1.0), SMALLEST_SPREAD**2))
        if sweep >= WARM_UP:
            total, square = total + centre, square + centre**2 + variance
    kept = SWEEPS - WARM_UP
    centre = total / kept
    return MixtureLaw(means, spreads, weights, centre, np.sqrt((square / kept - centre**2).clip(0.0)))


class _Components:
    """Gibbs sampler of the messages' components, with all delays integrated out, for all windows at once."""

    def __init__(self, linear: LinearDelays, labels: np.ndarray) -> None:
        most = max(len(own) for own in linear.members)
        shape = (len(linear.members), most)
        self.index, self.count = np.full(shape, -1), len(labels)
        self.information, self.pull = np.zeros((*shape, most)), np.zeros(shape)
        for w, (own, a, h) in enumerate(zip(linear.members, linear.information, linear.pull, strict=True)):
            self.index[w, : len(own)] = own
            self.information[w, : len(own), : len(own)], self.pull[w, : len(own)] = a, h
        self.there = self.index >= 0
        self.labels = np.where(self.there, labels[self.index], 0)

    def draw(
        self,
        means: np.ndarray,
        spreads: np.ndarray,
        weights: np.ndarray,
        generator: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw all components once, and compute the delays given all components.

        Neighbouring messages are drawn in pairs, because their delays are correlated.

        Returns:
            Components (K, C) as zeros and ones, means (K,) [s] and variances (K,) [s^2] of the delays.
        """
        covariance, pull = self._posterior(means, spreads)
        places = self.index.shape[1]
        for j in range(max(places - 1, 1)):
            pair = np.arange(j, min(j + 2, places))
            self._draw_pair(pair, covariance, pull, means, spreads, weights, generator)
        centre = np.einsum("wij,wj->wi", covariance, pull)
        variance = np.einsum("wii->wi", covariance)
        result = np.zeros((3, self.count))
        result[:, self.index[self.there]] = [x[self.there] for x in (self.labels, centre, variance)]
        return np.eye(len(means))[result[0].astype(int)], result[1], result[2].clip(0.0)

    def _draw_pair(
        self,
        pair: np.ndarray,
        covariance: np.ndarray,
        pull: np.ndarray,
        means: np.ndarray,
        spreads: np.ndarray,
        weights: np.ndarray,
        generator: np.random.Generator,
    ) -> None:
        """Draw the components of one or two messages of every window together, and update the posterior."""
        count = len(pair)
        combined = np.array(list(itertools.product(range(len(means)), repeat=count)))  # (choices, count)
        precision, tilt = spreads**-2, means / spreads**2
        old = self.labels[:, pair]
        # Likelihood of these delays given all other messages: exp(-eps' own eps / 2 + rest' eps).
        inverse = np.linalg.inv(covariance[:, pair[:, None], pair])
        centre = np.einsum("wpj,wj->wp", covariance[:, pair], pull)
        own = inverse - precision[old][:, :, None] * np.eye(count)
        rest = np.einsum("wpq,wq->wp", inverse, centre) - tilt[old]
        # Log marginal likelihood of each choice of components.
        total = own[:, None] + precision[combined][:, :, None] * np.eye(count)
        right = rest[:, None] + tilt[combined]
        score = np.log(weights / spreads)[combined].sum(1) - 0.5 * (means * tilt)[combined].sum(1)
        explained = (right * np.linalg.solve(total, right[..., None])[..., 0]).sum(-1)
        score = score + 0.5 * explained - 0.5 * np.linalg.slogdet(total)[1]
        share = np.exp(score - score.max(1, keepdims=True)).cumsum(1)
        choice = (generator.random((len(share), 1)) * share[:, -1:] > share[:, :-1]).sum(1)
        for place, new in zip(pair, combined[choice].T, strict=True):
            was = self.labels[:, place].copy()
            changed = np.flatnonzero((new != was) & self.there[:, place])
            now, was = new[changed], was[changed]
            self.labels[changed, place] = now
            pull[changed, place] += tilt[now] - tilt[was]
            # Sherman-Morrison update for the changed precision of one delay.
            more = precision[now] - precision[was]
            column = covariance[changed, place]
            change = more / (1.0 + more * column[:, place])
            covariance[changed] -= change[:, None, None] * column[:, :, None] * column[:, None, :]

    def _posterior(self, means: np.ndarray, spreads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariance (W, n, n) of each window's delays given the components, and precision times mean (W, n)."""
        sd, mean = spreads[self.labels], means[self.labels]
        inner = np.eye(sd.shape[1]) + sd[:, :, None] * self.information * sd[:, None, :]
        return sd[:, :, None] * np.linalg.inv(inner) * sd[:, None, :], self.pull + mean / sd**2

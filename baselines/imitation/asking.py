"""Rules that choose the steps to ask about."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from baselines.imitation.config import ImitationConfig
from baselines.imitation.ensemble import Ensemble
from baselines.imitation.learner import Labels


@dataclass(frozen=True)
class Seen:
    """What a step shows to a rule.

    Attributes:
        observations: (B, N).
        doubts: Disagreement of the members there (B,).
        running: Which environments are in an episode (B,) bool.
    """

    observations: Tensor
    doubts: Tensor
    running: np.ndarray


Score = Callable[[Ensemble, Labels, Seen], Tensor]
"""How much an answer is wanted: (B,), at least 0."""
SMALLEST = 1e-12  # threshold, so that it can grow again
LARGEST_WEIGHT = 5.0  # of an answer; the step that was hardly asked about does not outweigh the others


def doubt(ensemble: Ensemble, labels: Labels, seen: Seen) -> Tensor:
    """Disagreement of the members (B,), in half ranges of the action.

    Source: Menda et al. (2019), EnsembleDAgger.
    """
    return seen.doubts


def novelty(ensemble: Ensemble, labels: Labels, seen: Seen) -> Tensor:
    """Distance (B,) of scaled observations to the nearest one that was answered.

    Source: Hoque et al. (2021) ask where an observation is novel; the distance to the nearest is the plainest measure.
    """
    known = ensemble.observed(labels.observations)
    if not len(known):
        return torch.ones(len(seen.observations), dtype=torch.float64)
    return torch.cdist(ensemble.observed(seen.observations), known).amin(-1).double()


class Rule(Protocol):
    """Chooses steps."""

    @property
    def threshold(self) -> Threshold | None:
        """Of its scores; None where it has none."""
        ...

    def choose(self, ensemble: Ensemble, labels: Labels, seen: Seen) -> np.ndarray:
        """Weight (B,) of an answer in the fit, 0 where none is wanted; it is wanted only in an episode."""
        ...


class Always:
    """Asks about every step, as DAgger."""

    threshold: Threshold | None = None

    def choose(self, ensemble: Ensemble, labels: Labels, seen: Seen) -> np.ndarray:
        """All that run."""
        return seen.running.astype(float)


class AtRandom:
    """Asks about a share of the steps, whatever they show."""

    threshold: Threshold | None = None

    def __init__(self, rate: float, generator: torch.Generator) -> None:
        """Set the share.

        Args:
            rate: Share of steps.
            generator: Of the draws.
        """
        self._rate, self._generator = rate, generator

    def choose(self, ensemble: Ensemble, labels: Labels, seen: Seen) -> np.ndarray:
        """Each that runs with the same probability."""
        drawn = torch.rand(len(seen.running), generator=self._generator).numpy() < self._rate
        return (drawn & seen.running).astype(float)


class Threshold:
    r"""A number h of the size of scores that adapts to the wanted share r of questions.

    h starts at the largest score of the first step. After each step $\log h \leftarrow \log h + g (q - r)$, q the share
    that was asked. Summed over n steps, the mean of q differs from r by $\log(h_n / h_0) / (g n)$ and no more: whatever
    the scores do, as long as they stay within some orders of magnitude, the share that is asked comes to r.

    Source: Hoque et al. (2021), ThriftyDAgger, whose threshold is the (1 - r)-quantile of what was visited; the steps
    are those of Robbins and Monro (1951) to that quantile.
    """

    def __init__(self, rate: float, gain: float, floor: float = 0.0) -> None:
        """Wait for the first scores.

        Args:
            rate: r.
            gain: g; 0 keeps h at the floor.
            floor: Smallest h.
        """
        self._rate, self._gain, self._floor = rate, gain, max(floor, SMALLEST)
        self.value = math.nan if gain else self._floor

    def over(self, scores: np.ndarray) -> float:
        """h for the scores (n,) of a step, n > 0."""
        if math.isnan(self.value):
            self.value = max(float(scores.max()), self._floor)
        return self.value

    def move(self, share: float) -> None:
        """Take in the share that was asked."""
        self.value = max(self.value * math.exp(self._gain * (share - self._rate)), self._floor)


class AboveThreshold:
    """Asks where a score is above a threshold."""

    def __init__(self, score: Score, threshold: Threshold) -> None:
        """Set the score.

        Args:
            score: Of observations.
            threshold: Adapts to the wanted share.
        """
        self._score, self.threshold = score, threshold

    def choose(self, ensemble: Ensemble, labels: Labels, seen: Seen) -> np.ndarray:
        """Where the score is above the threshold, which follows."""
        scores = self._score(ensemble, labels, seen).numpy()
        asked = (scores > self.threshold.over(scores[seen.running])) & seen.running
        self.threshold.move(asked.sum() / seen.running.sum())
        return asked.astype(float)


class Drawn:
    r"""Asks with a probability that grows with a score: p = min(1, score / h), h a `Threshold`.

    An answer has the weight 1: what scores high is learned more than it is visited. Or it has the weight r / p, at
    most `LARGEST_WEIGHT`: then the expected loss is that over all visited steps, and the score only says where it is
    looked at closely.

    Source: Cesa-Bianchi, Gentile and Zaniboni (2006), Worst-case analysis of selective sampling for linear
    classification, who draw by the margin; Beygelzimer, Dasgupta and Langford (2009), Importance weighted active
    learning, for the weights.
    """

    def __init__(
        self, score: Score, threshold: Threshold, generator: torch.Generator, rate: float | None = None
    ) -> None:
        """Set the score.

        Args:
            score: Of observations.
            threshold: Adapts to the wanted share.
            generator: Of the draws.
            rate: r of the weights; None: all weights are 1.
        """
        self._score, self.threshold, self._generator, self._rate = score, threshold, generator, rate

    def choose(self, ensemble: Ensemble, labels: Labels, seen: Seen) -> np.ndarray:
        """Drawn for each that runs; the threshold follows."""
        scores = self._score(ensemble, labels, seen).numpy()
        chance = np.minimum(1.0, scores / self.threshold.over(scores[seen.running]))
        drawn = torch.rand(len(seen.running), generator=self._generator).numpy()
        asked = (drawn < chance) & seen.running
        self.threshold.move(asked.sum() / seen.running.sum())
        rates = np.ones_like(chance) if self._rate is None else self._rate / np.maximum(chance, SMALLEST)
        return np.where(asked, np.minimum(rates, LARGEST_WEIGHT), 0.0)


def make_rule(config: ImitationConfig, generator: torch.Generator) -> Rule:
    """The rule of some settings.

    Args:
        config: Its name, rate, gain and floor.
        generator: Of its draws.
    """
    rate, gain = config.query_rate, config.threshold_gain
    of_doubt = Threshold(rate, gain, config.smallest_doubt)
    rules: dict[str, Callable[[], Rule]] = {
        "doubt": lambda: AboveThreshold(doubt, of_doubt),
        "drawn": lambda: Drawn(doubt, of_doubt, generator),
        "weighted": lambda: Drawn(doubt, of_doubt, generator, rate),
        "fixed": lambda: AboveThreshold(doubt, Threshold(rate, 0.0, config.smallest_doubt)),
        "novelty": lambda: AboveThreshold(novelty, Threshold(rate, gain)),
        "random": lambda: AtRandom(rate, generator),
        "always": Always,
    }
    return rules[config.rule]()

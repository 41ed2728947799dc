"""What was answered so far, and the fit of the ensemble to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from baselines.imitation.config import ImitationConfig
from baselines.imitation.ensemble import Ensemble
from baselines.imitation.questions import Label


class Labels:
    """Observations with the teacher's actions, and how often each member of the ensemble has drawn each.

    A bootstrap of a growing set draws every sample Poisson(1) times for each member when it comes.

    Attributes:
        observations: (n, N) float64.
        targets: Actions in [-1, 1] (n, M) float32.
        counts: By the weights of the answers (E, n) float32.

    Source: Oza and Russell (2001), Online bagging and boosting.
    """

    def __init__(self, size: int, actions: int, members: int) -> None:
        """Start empty.

        Args:
            size: N.
            actions: M.
            members: E.
        """
        self.observations = torch.empty(0, size, dtype=torch.float64)
        self.targets, self.counts = torch.empty(0, actions), torch.empty(members, 0)

    def __len__(self) -> int:
        return len(self.targets)

    def add(self, observations: Tensor, targets: Tensor, weights: Tensor, generator: torch.Generator) -> None:
        """Take in observations (n, N) with targets (n, M) and weights (n,)."""
        counts = torch.poisson(torch.ones(len(self.counts), len(targets)), generator) * weights
        self.observations = torch.cat([self.observations, observations])
        self.targets, self.counts = torch.cat([self.targets, targets]), torch.cat([self.counts, counts], 1)

    def state_dict(self) -> dict[str, Tensor]:
        """All of it."""
        return {"observations": self.observations, "targets": self.targets, "counts": self.counts}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take what `state_dict` gave."""
        self.observations, self.targets = state["observations"], state["targets"]
        self.counts = state["counts"]


class Learner:
    r"""Fits each member to its bootstrap: minimises $\sum_i c_{ei} |u_e(o_i) - a_i|^2$, a_i in half ranges.

    Attributes:
        ensemble: The networks.
        labels: What was answered.
        updates: Steps of Adam so far.
    """

    def __init__(self, ensemble: Ensemble, config: ImitationConfig) -> None:
        """Start without a label.

        Args:
            ensemble: Networks to train.
            config: Sizes and step sizes.
        """
        self.ensemble, self._config, self.updates = ensemble, config, 0
        size = len(ensemble.observed.moments.mean)
        self.labels = Labels(size, len(ensemble.low), ensemble.members)
        self._adam = torch.optim.Adam(ensemble.parameters(), lr=config.learning_rate, fused=True)

    def add(self, answered: Sequence[Label], generator: torch.Generator) -> None:
        """Take in answers.

        Args:
            answered: n of them.
            generator: Of the bootstraps.
        """
        if not len(answered):
            return
        observations, actions, weights = (
            torch.from_numpy(np.asarray(part, np.float64)) for part in zip(*answered, strict=True)
        )
        self.ensemble.observed.add(observations)
        self.labels.add(observations, self.ensemble.to_unit(actions), weights.float(), generator)

    def fit(self, generator: torch.Generator) -> float:
        """Make the updates of a round.

        Args:
            generator: Of the minibatches.

        Returns:
            Mean squared error of the minibatches, over the members and their bootstraps; NaN without an answer.
        """
        config, labels = self._config, self.labels
        if not len(labels):
            return float("nan")
        total, seen = torch.zeros(()), self.ensemble.observed(labels.observations)
        for update in range(config.updates):
            left = 1.0 - update / config.updates
            share = config.final_learning_rate + left * (1.0 - config.final_learning_rate)
            for group in self._adam.param_groups:
                group["lr"] = config.learning_rate * share
            chosen = torch.randint(len(labels), (config.minibatch,), generator=generator)
            counts = labels.counts[:, chosen]
            error = self.ensemble.outputs(seen[chosen]) - labels.targets[chosen]
            errors = (counts * error.square().mean(-1)).mean(-1)
            self._adam.zero_grad()
            # A sum over the members: none of them feels the others.
            errors.sum().backward()
            self._adam.step()
            total += errors.detach().mean()
        self.updates += config.updates
        return float(total) / config.updates

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimiser and labels."""
        return {
            "ensemble": self.ensemble.state_dict(),
            "adam": self._adam.state_dict(),
            "labels": self.labels.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take what `state_dict` gave."""
        self.ensemble.load_state_dict(state["ensemble"])
        self._adam.load_state_dict(state["adam"])
        self.labels.load_state_dict(state["labels"])
        self.updates = state["updates"]

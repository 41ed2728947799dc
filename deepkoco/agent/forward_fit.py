"""Fits a forward model to the episodes that a training run has collected: nothing more is asked of the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from deepkoco.agent.buffer import Episode
from deepkoco.koopman.forward_model import ForwardModel, ForwardModelError


@dataclass(frozen=True)
class ForwardFitConfig:
    """How a forward model is fitted."""

    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers."""
    horizon: int = 5
    """Steps predicted in training; longer ones make each step worse and did not help over ten steps."""
    updates: int = 3000
    """Steps of Adam, with a step size that falls to zero along a cosine."""
    learning_rate: float = 3e-3
    """First step size."""
    batch: int = 256
    """Windows per update."""
    held_out: float = 0.1
    """Share of the episodes, the last ones, that the error is measured on."""


@dataclass(frozen=True)
class FittedForwardModel:
    """A forward model and what it is worth.

    Attributes:
        model: The model.
        errors: By number of steps 1 .. horizon, the root mean square of the error on episodes held out, relative to
            the spread of the observations; on those it was fitted to where there is only one.
    """

    model: ForwardModel
    errors: tuple[float, ...]


class _Network(nn.Module):
    """o + sd * net((o - mean) / sd, (a - mean) / sd)."""

    def __init__(self, mean: Tensor, sd: Tensor, change_sd: Tensor, hidden: Sequence[int]) -> None:
        super().__init__()
        sizes = [mean.numel(), *hidden, change_sd.numel()]
        self.mean, self.sd, self.change_sd = mean, sd, change_sd
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        x = (torch.cat((observation, action), -1) - self.mean) / self.sd
        for layer in self.layers[:-1]:
            x = torch.tanh(layer(x))
        return observation + self.change_sd * self.layers[-1](x)

    def folded(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """The layers with the scales of inputs and outputs in the first and the last one."""
        layers = [
            (layer.weight.detach().double(), layer.bias.detach().double())
            for layer in self.layers
            if isinstance(layer, nn.Linear)
        ]
        weight, bias = layers[0]
        layers[0] = weight / self.sd, bias - weight @ (self.mean / self.sd).double()
        weight, bias = layers[-1]
        layers[-1] = weight * self.change_sd[:, None], bias * self.change_sd
        return tuple((weight.numpy(), bias.numpy()) for weight, bias in layers)


def fit_forward_model(
    episodes: Sequence[Episode], time_step: float, seed: int, config: ForwardFitConfig | None = None
) -> FittedForwardModel:
    """Fit a forward model to episodes without delays.

    Args:
        episodes: On states, at least one longer than the horizon.
        time_step: Seconds per step.
        seed: Of first weights and minibatches.
        config: Settings.

    Returns:
        The model and its errors.

    Raises:
        ForwardModelError: The observations are frames, or no episode is long enough.
    """
    config = config or ForwardFitConfig()
    if any(episode.observations.ndim != 2 for episode in episodes):
        raise ForwardModelError("forward models predict states; these episodes hold frames")
    long = [e for e in episodes if len(e.actions) > config.horizon]
    if not long:
        raise ForwardModelError(f"no episode is longer than {config.horizon} steps; nothing to fit to")
    kept = max(1, len(long) - max(1, round(config.held_out * len(long))))
    learned, judged = long[:kept], long[kept:] or long
    x = torch.cat([torch.cat((e.observations, e.actions), -1) for e in learned])
    change = torch.cat([e.observations.diff(dim=0) for e in learned])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = _Network(x.mean(0), _spread(x), _spread(change), config.hidden)
    _fit(network, *_windows(learned, config.horizon), seed, config)
    with torch.no_grad():
        observations, actions = _windows(judged, config.horizon)
        errors = _errors(network, observations, actions).square().mean((0, 2)).sqrt()
    return FittedForwardModel(ForwardModel(network.folded(), time_step), tuple(errors.tolist()))


def _fit(
    network: _Network, observations: Tensor, actions: Tensor, seed: int, config: ForwardFitConfig
) -> None:
    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(network.parameters(), config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.updates)
    for _ in range(config.updates):
        drawn = torch.randint(len(observations), (config.batch,), generator=generator)
        loss = _errors(network, observations[drawn], actions[drawn]).square().mean()
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()


def _errors(network: _Network, observations: Tensor, actions: Tensor) -> Tensor:
    """Errors of repeated predictions from the first of K + 1 observations, relative to their spread (W, K, N)."""
    predicted, errors = observations[:, 0], []
    sd = network.sd[: observations.shape[-1]]
    for k in range(actions.shape[1]):
        predicted = network(predicted, actions[:, k])
        errors.append((predicted - observations[:, k + 1]) / sd)
    return torch.stack(errors, 1)


def _windows(episodes: Sequence[Episode], horizon: int) -> tuple[Tensor, Tensor]:
    """All windows of K + 1 observations (W, K + 1, N) and K actions (W, K, M)."""
    observations = torch.cat([e.observations.unfold(0, horizon + 1, 1).mT for e in episodes])
    actions = torch.cat([e.actions[:-1].unfold(0, horizon, 1).mT for e in episodes])
    return observations, actions


def _spread(values: Tensor) -> Tensor:
    """Standard deviation of each column, 1 for one that does not change."""
    sd = values.std(0)
    return torch.where(sd > 1e-8, sd, torch.ones_like(sd))

"""The baselines by name: their settings and how their networks and losses are put together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from baselines.actor import Actor
from baselines.config import (
    BaselineConfig,
    BaselineConfigError,
    DbcConfig,
    DeepMdpConfig,
    SacConfig,
    SharedSacConfig,
)
from baselines.critic import Critic
from baselines.dbc import Dbc
from baselines.deepmdp import DeepMdp
from baselines.replay import Batch
from baselines.sac import Losses, Sac, separate_networks, shared_networks


class Learner(Protocol):
    """What a training run asks of an algorithm."""

    logged: tuple[str, ...]
    """Names of what `update` gives, not all of them every time."""

    @property
    def actor(self) -> Actor:
        """Chooses the actions."""
        ...

    @property
    def critic(self) -> Critic:
        """Holds the encoder."""
        ...

    @property
    def updates(self) -> int:
        """Updates done."""
        ...

    def update(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Learn from a minibatch; what is logged, by name."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """All that a checkpoint needs."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""


@dataclass(frozen=True)
class Baseline:
    """An algorithm.

    Attributes:
        settings: Class of its hyper-parameters.
        networks: Actor and critics from (shape of an observation, M, hyper-parameters).
        learner: Its `Learner` from (SAC on these networks, M, hyper-parameters).
    """

    settings: type[BaselineConfig]
    networks: Callable[[Sequence[int], int, Any], tuple[Actor, Critic]]
    learner: Callable[[Sac, int, Any], Learner]


def _alone(sac: Sac, action_size: int, config: BaselineConfig) -> Sac:
    return sac


BASELINES = {
    "sac": Baseline(SacConfig, separate_networks, _alone),
    "sac_shared": Baseline(SharedSacConfig, shared_networks, _alone),
    "deepmdp": Baseline(DeepMdpConfig, shared_networks, DeepMdp),
    "dbc": Baseline(DbcConfig, shared_networks, Dbc),
}


def baseline(name: str) -> Baseline:
    """Look a baseline up.

    Args:
        name: Of the algorithm.

    Raises:
        BaselineConfigError: There is none of that name.
    """
    if name not in BASELINES:
        raise BaselineConfigError(f'name = "{name}"; choose one of {", ".join(BASELINES)}')
    return BASELINES[name]


def make_networks(shape: Sequence[int], action_size: int, config: BaselineConfig) -> tuple[Actor, Critic]:
    """Actor and critics of a baseline.

    Args:
        shape: (N,) of states or (H, W, 3) of frames.
        action_size: M.
        config: Hyper-parameters; its name says which baseline.
    """
    return baseline(config.name).networks(shape, action_size, config)


def make_learner(shape: Sequence[int], action_size: int, config: BaselineConfig) -> Learner:
    """A baseline with fresh networks; see `make_networks`."""
    sac = Sac(*make_networks(shape, action_size, config), action_size, config)
    return baseline(config.name).learner(sac, action_size, config)

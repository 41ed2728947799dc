"""DeepKoCo at the end of its training, as it is compared with references."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import Episode
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.first_episodes import make_noise, random_count
from deepkoco.agent.metrics import Row
from deepkoco.agent.references.measure import Trained
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.planning.config import PlannerConfig


def trained_deepkoco(
    config: TrainingConfig,
    model: ExportedModel,
    planner: PlannerConfig,
    first: Sequence[Episode],
    rows: Sequence[Row],
    low: Array,
    high: Array,
    seed: int,
) -> Trained:
    """Put together what is compared.

    Args:
        config: Hyper-parameters.
        model: The trained model.
        planner: Settings of its planner.
        first: Episodes of the first iteration as they were recorded.
        rows: Metrics.
        low: a_min (M,).
        high: a_max (M,).
        seed: Of the run.
    """
    own = derive_seed(seed, Purpose.REFERENCES)

    def exploration(count: int) -> VectorAgent:
        generator = torch.Generator().manual_seed(own)
        noise = make_noise(config, count, False, config.noise_variance, low, high, generator)
        return VectorAgent(None, planner, low, high, count, noise)

    return Trained(
        name=config.name,
        controller=lambda count: VectorAgent(model, planner, low, high, count, seed=own),
        exploration=exploration,
        first=first[: random_count(config)],
        rows=rows,
        planner=planner,
        action_weight=model.action_weight,
        time_step=model.time_step,
        low=low,
        high=high,
        window=config.horizon + 1,
        plans=True,
        total_episodes=config.total_episodes,
        seed=own,
    )

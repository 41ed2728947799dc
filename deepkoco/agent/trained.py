"""DeepKoCo at the end of its training, as it is compared with references."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import Episode
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.first_episodes import make_noise
from deepkoco.agent.metrics import Row
from deepkoco.agent.references.measure import Trained
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.koopman.exported import Array
from deepkoco.koopman.latent_model import LatentModel
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.planning.config import PlannerConfig

KEPT_LINEAR = "EDMDc of the run's own episodes, which did better than every network"


def trained_deepkoco(
    config: TrainingConfig,
    model: LatentModel,
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
        first: Those episodes that noise alone has moved, as they were recorded.
        rows: Metrics.
        low: a_min (M,).
        high: a_max (M,).
        seed: Of the run.
    """
    own = derive_seed(seed, Purpose.REFERENCES)

    def exploration(count: int) -> VectorAgent:
        generator = torch.Generator().manual_seed(own)
        noise = make_noise(config, count, 1.0, config.noise_variance, low, high, generator)
        return VectorAgent(None, planner, low, high, count, noise)

    return Trained(
        name=config.name,
        controller=lambda count: VectorAgent(model, planner, low, high, count, seed=own),
        exploration=exploration,
        first=first,
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
        kept=KEPT_LINEAR if isinstance(model, LiftedLinearModel) else "",
    )

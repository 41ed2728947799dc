"""DeepKoCo at the end of its training, as it is compared with references."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.experience import Experience
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
    experience: Experience,
    result: tuple[LatentModel, PlannerConfig],
    rows: Sequence[Row],
    low: Array,
    high: Array,
    seed: int,
) -> Trained:
    """Put together what is compared.

    Args:
        experience: What the run has collected.
        result: The trained model, and the settings of its planner.
        rows: Metrics.
        low: a_min (M,).
        high: a_max (M,).
        seed: Of the run.
    """
    config, (model, planner) = experience.learning, result
    own = derive_seed(seed, Purpose.REFERENCES)

    def exploration(count: int) -> VectorAgent:
        generator = torch.Generator().manual_seed(own)
        noise = make_noise(config, count, 1.0, config.noise_variance, low, high, generator)
        return VectorAgent(None, planner, low, high, count, noise)

    return Trained(
        name=config.name,
        controller=lambda count: VectorAgent(model, planner, low, high, count, seed=own),
        exploration=exploration,
        first=experience.first()[: experience.alone],
        rows=rows,
        planner=experience.linear_planner,
        action_weight=experience.linear_action_weight,
        time_step=model.time_step,
        low=low,
        high=high,
        window=config.horizon + 1,
        plans=True,
        total_episodes=config.total_episodes,
        seed=own,
        kept=KEPT_LINEAR if isinstance(model, LiftedLinearModel) else "",
        to_come=config.cost_discount > 0.0,
    )

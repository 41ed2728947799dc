"""What a run has collected is the same after a restart, with the settings that its first episodes called for."""

import numpy as np
import torch

from deepkoco.agent.buffer import Episode
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.experience import Experience

CONFIG = TrainingConfig(first_episodes=18)
LIMITS = -np.ones(1), np.ones(1)


def fallen(count: int, seed: int) -> list[Episode]:
    """Episodes of 8 to 12 steps that pay 1 each until the task ends them."""
    draws = torch.Generator().manual_seed(seed)
    lengths = torch.randint(8, 13, (count,), generator=draws).tolist()
    return [
        Episode(
            torch.randn(n, 2, generator=draws),
            torch.randn(n, 1, generator=draws).clamp(-1.0, 1.0),
            torch.full((n,), -1.0),
            torch.randn(2, generator=draws),
        )
        for n in lengths
    ]


def test_short_episodes_shorten_windows_and_plans_before_and_after_a_restart(tmp_path):
    (tmp_path / "replay").mkdir()
    run = Experience(tmp_path, CONFIG, 1, *LIMITS)
    run.add(0, fallen(18, 0))
    run.add(1, fallen(4, 1))
    again = Experience(tmp_path, CONFIG, 1, *LIMITS)
    again.restore(run.state_dict(), 2)
    assert run.learning.horizon < CONFIG.horizon
    assert run.learning.planner.horizon < CONFIG.planner.horizon
    assert run.learning.cost_discount == CONFIG.rare_discount
    assert again.learning == run.learning
    assert again.planner == run.planner
    assert again.buffer.windows(run.learning.horizon) == run.buffer.windows(run.learning.horizon)


def test_linear_models_keep_the_weights_of_single_steps(tmp_path):
    (tmp_path / "replay").mkdir()
    far, plain = (
        Experience(tmp_path, config, 1, *LIMITS)
        for config in (CONFIG, TrainingConfig(first_episodes=18, rare_discount=0.0))
    )
    for run in (far, plain):
        run.add(0, fallen(18, 0))
    assert far.linear_action_weight == plain.linear_action_weight
    assert far.linear_planner.increment_weight == plain.linear_planner.increment_weight
    assert far.planner.increment_weight != plain.planner.increment_weight

"""What a run has collected is the same after a restart, with the settings that its first episodes called for."""

from dataclasses import replace

import numpy as np
import torch

from deepkoco.agent.buffer import Episode
from deepkoco.agent.config import OLDER_SETTINGS, TrainingConfig
from deepkoco.agent.discounting import discounted_mean
from deepkoco.agent.experience import Experience
from deepkoco.agent.replay_files import write_replay
from deepkoco.agent.task_scale import TaskScale

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


def test_a_run_of_an_earlier_release_goes_on_with_means_of_its_scaled_costs_however_often_it_restarts(
    tmp_path,
):
    (tmp_path / "replay").mkdir()
    older = {name: OLDER_SETTINGS[name] for name in ("rare_discount", "fit_horizon")}
    config = replace(CONFIG, cost_discount=0.9, **older)
    episodes = fallen(18, 0)
    write_replay(tmp_path, 0, episodes)
    scale = TaskScale.of(episodes, *LIMITS)
    state = {
        name: value for name, value in scale.state_dict().items() if name not in ("discount", "step_cost")
    }
    first, second = (Experience(tmp_path, config, 1, *LIMITS) for _ in range(2))
    first.restore({"scale": state}, 1)
    second.restore(first.state_dict(), 1)
    for run in (first, second):
        batch = run.buffer.sample(1, 23, 22, torch.Generator().manual_seed(0))
        choices = [discounted_mean(scale.apply(e, 15).costs, 0.9) for e in episodes]
        assert any(torch.equal(batch.costs[0], costs[:23]) for costs in choices if costs.numel() >= 23)
        assert run.learning == config


def test_a_new_run_discounts_once_in_the_units_of_the_task(tmp_path):
    (tmp_path / "replay").mkdir()
    run = Experience(tmp_path, replace(CONFIG, cost_discount=0.9), 1, *LIMITS)
    run.add(0, fallen(18, 0))
    again = Experience(tmp_path, replace(CONFIG, cost_discount=0.9), 1, *LIMITS)
    again.restore(run.state_dict(), 1)
    assert again.scale is not None
    assert again.scale.discount == 0.9
    assert again.buffer.discount == 0.0


def test_what_the_first_episodes_decided_is_told_and_nothing_where_all_stays_as_given(tmp_path):
    (tmp_path / "replay").mkdir()
    run = Experience(tmp_path, CONFIG, 1, *LIMITS)
    assert (run.decided, run.decision) == ({}, "")
    run.add(0, fallen(18, 0))
    own = run.learning
    assert run.decided == {
        "horizon": own.horizon,
        "planner_horizon": own.planner.horizon,
        "cost_discount": 0.95,
    }
    assert run.decision == (
        f"the first episodes call for T = {own.horizon}, H = {own.planner.horizon} and costs to come with gamma = 0.95"
    )


def test_predictions_of_costs_to_come_are_compared_with_costs_to_come(tmp_path):
    (tmp_path / "replay").mkdir()
    run = Experience(tmp_path, CONFIG, 1, *LIMITS)
    run.add(0, fallen(18, 0))
    (costs,) = run.predicted_costs(fallen(1, 2), linear=False) or []
    # A task that pays 1 a step: n steps before its end -(1 - 0.95^n) of at best -1 is left, and the end holds the last.
    left = np.arange(costs.size - 1, 0, -1)
    np.testing.assert_allclose(costs[:-1], 0.95**left, atol=1e-6)
    assert costs[-1] == costs[-2]
    assert run.predicted_costs(fallen(1, 2), linear=True) is None
    steps = Experience(tmp_path, replace(CONFIG, cost_discount=0.9, scale=False), 1, *LIMITS)
    cut = replace(fallen(1, 2)[0], costs=torch.arange(9.0), final=None)
    np.testing.assert_array_equal(steps.predicted_costs([cut], linear=True), [np.arange(9.0)])
    np.testing.assert_allclose(steps.predicted_costs([cut], linear=False), [discounted_mean(cut.costs, 0.9)])

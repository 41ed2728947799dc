"""The first iteration: noise alone, then the planner on a linear model where that is worth it."""

from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
import torch

from deepkoco.agent.buffer import Episode
from deepkoco.agent.collection import episode_costs
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.first_episodes import (
    TRIALS,
    calm_rounds,
    collect_first,
    make_noise,
    random_count,
)
from deepkoco.agent.fitted_settings import often_ended
from experiments.studies.learning.untuned_envs import Cart

CONFIG = TrainingConfig(first_episodes=45, warm_start=0.67)


def carts(count):
    return gymnasium.vector.SyncVectorEnv([lambda: gymnasium.wrappers.TimeLimit(Cart(), 100)] * count)


def pendulums(count):
    return gymnasium.make_vec("Pendulum-v1", num_envs=count, vectorization_mode="sync", max_episode_steps=100)


def collect(make, config, limit):
    low, high = np.array([-limit]), np.array([limit])
    generator = torch.Generator().manual_seed(0)
    noise = partial(make_noise, config, variance=0.85, low=low, high=high, generator=generator)
    episodes, failures = collect_first(config, make, low, high, noise, run_seed=0)
    assert failures == 0
    return episode_costs(episodes)


def test_a_task_that_a_linear_model_masters_is_explored_where_it_is():
    costs = collect(carts, CONFIG, 1.0)
    random = random_count(CONFIG)
    assert (len(costs), random) == (45, 15)
    assert costs[random:].mean() < 0.3 * costs[:random].mean()


def test_noise_alone_goes_on_where_the_first_planned_episodes_are_no_cheaper():
    costs = collect(pendulums, CONFIG, 2.0)
    alone = collect(pendulums, replace(CONFIG, warm_start=0.0), 2.0)
    assert len(costs) == len(alone) == 45
    behind = costs[random_count(CONFIG) + TRIALS :]
    assert behind.mean() == pytest.approx(alone.mean(), rel=0.3)


def test_without_a_warm_start_noise_drives_all():
    assert random_count(replace(CONFIG, warm_start=0.0)) == 45


def test_exploration_is_calmer_where_the_task_ended_most_random_episodes():
    ended, cut = Episode(*[torch.zeros(3, 1)] * 3, torch.zeros(1)), Episode(*[torch.zeros(3, 1)] * 3)
    assert often_ended([ended, ended, cut])
    assert not often_ended([ended, cut])
    config = replace(CONFIG, noise_floor=0.01)
    one = np.ones(1)
    bold, calm = (
        make_noise(config, 2, floor, 1.0, -one, one, torch.Generator().manual_seed(0)).step()
        for floor in (1.0, 0.01)
    )
    torch.testing.assert_close(calm, bold * torch.tensor([[1.0], [0.01]]).double())


def falls(lengths):
    """Episodes that the task ended after so many steps."""
    return [Episode(*[torch.zeros(n, 1)] * 3, torch.zeros(1)) for n in lengths]


def test_exploration_grows_calmer_until_an_episode_is_as_long_as_a_window():
    config = TrainingConfig(first_episodes=60, warm_start=0.8, horizon=15, noise_floor=0.1)
    random = [4] * random_count(config)
    assert calm_rounds(config, falls([20] * len(random))) == (0.1, len(random), False)
    assert calm_rounds(config, falls(random)) == (0.1, len(random), True)
    once = [*random, 4, 4, 5, 5, 6, 7]
    floor, alone, wanted = calm_rounds(config, falls(once))
    assert (floor, alone, wanted) == (pytest.approx(0.01), len(once), True)
    twice = [*once, 4, 5, 6, 9, 12, 16]
    assert calm_rounds(config, falls(twice)) == (pytest.approx(0.01), len(twice), False)
    # The same is found when a run goes on whose planned episodes follow.
    assert calm_rounds(config, falls(twice + [50] * 30)) == (pytest.approx(0.01), len(twice), False)


def test_calmer_exploration_ends_where_it_makes_no_episode_longer():
    config = TrainingConfig(first_episodes=60, warm_start=0.8, horizon=15, noise_floor=0.1)
    random = [9] * random_count(config)
    assert calm_rounds(config, falls(random + [9] * TRIALS)) == (0.1, len(random) + TRIALS, False)
    assert calm_rounds(replace(config, noise_floor=1.0), falls(random)) == (1.0, len(random), False)

"""Settings that follow from the first episodes: where a reward is out of sight, and where episodes are short."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.agent.buffer import Episode
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.fitted_settings import fitted, fitted_horizon, out_of_sight

CONFIG = TrainingConfig()


def episode(costs, ended=False) -> Episode:
    costs = torch.as_tensor(np.asarray(costs), dtype=torch.float32)
    parts = torch.zeros(costs.numel(), 1), torch.zeros(costs.numel(), 1), costs
    return Episode(*parts, torch.zeros(1) if ended else None)


def with_goal(cheap: int, usual: float = 1.0, goal: float = 0.0) -> Episode:
    """200 steps, so many of which at the end are at the goal."""
    return episode([usual] * (200 - cheap) + [goal] * cheap)


@pytest.mark.parametrize(("usual", "goal"), [(1.0, 0.0), (0.0, -100.0)])
def test_a_reward_that_one_episode_in_ten_finds_is_out_of_sight(usual, goal):
    none, one = with_goal(0, usual), with_goal(30, usual, goal)
    assert out_of_sight([none] * 9 + [one], CONFIG.horizon)
    # 15 of 185 windows show the way to the goal where all episodes find it: not out of sight with longer windows.
    assert not out_of_sight([with_goal(30, usual, goal)] * 10, 40)


def test_costs_that_rise_only_now_and_then_are_in_sight():
    assert not out_of_sight([with_goal(1, usual=0.1, goal=100.0)] * 10, CONFIG.horizon)


def test_costs_that_never_differ_or_are_no_numbers_call_for_nothing():
    assert not out_of_sight([with_goal(0)] * 3, CONFIG.horizon)
    assert not out_of_sight([episode([float("nan")] * 200)] * 3, CONFIG.horizon)
    assert not out_of_sight([episode([1.0] * 4 + [0.0])], CONFIG.horizon)  # shorter than a window


def test_windows_are_half_as_long_as_calm_episodes_that_the_task_ended():
    # The median of all is 5, of the last six 9.5; one that lasts for longer than a window is no usual one.
    lengths = [4] * 9 + [5] * 3 + [7, 9, 9, 10, 10, 30]
    short = [episode(np.full(n, -1.0), ended=True) for n in lengths]
    assert fitted_horizon(CONFIG, short) == 5
    settings = fitted(CONFIG, short)
    assert (settings.horizon, settings.planner.horizon) == (5, 4)
    assert settings.cost_discount == CONFIG.rare_discount
    settings.check()


def test_the_given_horizon_stays_where_calm_noise_shows_a_window_or_the_time_ended_the_episodes():
    long = [episode(np.full(n, -1.0), ended=True) for n in (4, 4, 5, 20, 20, 20, 20)]
    cut = [episode(np.full(n, -1.0)) for n in (4, 4, 5, 9)]
    assert fitted(CONFIG, long) == fitted(CONFIG, cut) == CONFIG


def test_published_settings_and_a_discount_of_the_user_stay_as_they_are():
    rare = [with_goal(0)] * 9 + [with_goal(30)]
    assert fitted(CONFIG, rare).cost_discount == 0.95
    for own in (
        replace(CONFIG, scale=False),
        replace(CONFIG, cost_discount=0.5),
        replace(CONFIG, rare_discount=0.0),
    ):
        assert fitted(own, rare) == own
    falls = [episode(np.full(5, -1.0), ended=True)] * 3
    for own in (replace(CONFIG, fit_horizon=False), replace(CONFIG, window_stride=16, chunk_length=16)):
        assert fitted(own, falls) == own


def test_costs_that_are_not_finite_are_left_out_of_what_is_decided():
    rare = [with_goal(0)] * 9 + [with_goal(30)]
    broken = rare[0].costs.clone()
    broken[::40] = float("nan")
    broken[1] = float("inf")
    assert out_of_sight([episode(broken), *rare[1:]], CONFIG.horizon)
    seen = [with_goal(30)] * 3 + [episode([1.0, float("inf")] * 10)]
    assert out_of_sight(seen, 40) == out_of_sight(seen[:3], 40)

"""Costs to come: by hand, and what holds for any costs."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.agent.buffer import Episode, EpisodeBuffer
from deepkoco.agent.discounting import costs_to_come, discounted_mean


def test_three_costs_by_hand():
    # gamma = 0.5. Last: 4. Before: (2 + 0.5 * 4) / 1.5 = 8 / 3. First: (1 + 0.5 * 2 + 0.25 * 4) / 1.75 = 12 / 7.
    ours = discounted_mean(torch.tensor([1.0, 2.0, 4.0]), 0.5)
    assert ours.tolist() == pytest.approx([12 / 7, 8 / 3, 4.0])


@settings(max_examples=30, deadline=None)
@given(
    costs=st.lists(st.floats(0, 100), min_size=1, max_size=40),
    discount=st.floats(0, 0.99),
    scale=st.floats(0, 5),
)
def test_it_is_a_mean(costs, discount, scale):
    tensor = torch.tensor(costs)
    mean = discounted_mean(tensor, discount)
    for k in range(len(costs)):
        assert min(costs[k:]) - 1e-4 <= mean[k].item() <= max(costs[k:]) + 1e-4
    torch.testing.assert_close(discounted_mean(scale * tensor, discount), scale * mean, rtol=1e-4, atol=1e-4)


def test_the_buffer_learns_from_discounted_costs_and_keeps_actions_and_observations():
    episode = Episode(torch.rand(9, 2), torch.rand(9, 1), torch.rand(9))
    buffers = [EpisodeBuffer(), EpisodeBuffer(discount=0.9)]
    batches = []
    for buffer in buffers:
        buffer.add([episode])
        batches.append(buffer.sample(1, 9, 8, torch.Generator().manual_seed(0)))
    plain, discounted = batches
    assert torch.equal(plain.observations, discounted.observations)
    assert torch.equal(plain.actions, discounted.actions)
    assert torch.equal(plain.costs[0], episode.costs)
    torch.testing.assert_close(discounted.costs[0], discounted_mean(episode.costs, 0.9))


def test_behind_an_end_that_the_task_made_nothing_is_paid():
    # gamma = 0.5, (1 - gamma) times the discounted sum. Last: 0.5 * 4. Before: 0.5 * (2 + 0.5 * 4). First:
    # 0.5 * (1 + 0.5 * 2 + 0.25 * 4).
    costs = torch.tensor([1.0, 2.0, 4.0])
    assert costs_to_come(costs, 0.5, ended=True).tolist() == pytest.approx([1.5, 2.0, 2.0])
    assert torch.equal(costs_to_come(costs, 0.5, ended=False), discounted_mean(costs, 0.5))


def test_a_bonus_at_the_end_fades_away_from_it_and_a_task_that_pays_is_worth_less_the_sooner_it_ends():
    bonus = costs_to_come(torch.tensor([0.0] * 20 + [-100.0]), 0.9, ended=True)
    assert (bonus.diff() < 0.0).all()
    alive = costs_to_come(torch.full((20,), -1.0), 0.9, ended=True)
    assert (alive.diff() > 0.0).all()
    assert alive.min() > -1.0


@pytest.mark.parametrize("unknown", [float("nan"), float("inf"), -float("inf")])
def test_a_cost_that_is_not_finite_is_left_out_of_the_means_before_it(unknown):
    # gamma = 0.5, the middle one of three is unknown. First: (1 + 0.25 * 4) / 1.25 = 1.6; then 4 and 4.
    costs = torch.tensor([1.0, unknown, 4.0])
    assert discounted_mean(costs, 0.5).tolist() == pytest.approx([1.6, 4.0, 4.0])
    # Before an end the same means count for (1 - gamma) times the steps that are left: 0.875, 0.75 and 0.5.
    assert costs_to_come(costs, 0.5, ended=True).tolist() == pytest.approx([1.4, 3.0, 2.0])


@pytest.mark.parametrize("ended", [False, True])
def test_behind_the_last_finite_cost_there_is_no_mean(ended):
    means = costs_to_come(torch.tensor([1.0, 1.0, float("inf")]), 0.5, ended)
    assert means.isfinite().tolist() == [True, True, False]

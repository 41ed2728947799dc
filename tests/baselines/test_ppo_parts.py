"""Parts of PPO by hand: moments, scaled rewards, advantages, losses, settings."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from baselines.config import BaselineConfigError
from baselines.ppo.advantages import advantages_of
from baselines.ppo.collection import EpisodeCosts
from baselines.ppo.config import PpoConfig
from baselines.ppo.learner import PpoLearner, Samples, explained_variance
from baselines.ppo.networks import ActorCritic
from baselines.ppo.scaling import RunningMoments, ScaledObservations, ScaledRewards

LOW, HIGH = np.array([-2.0]), np.array([4.0])


@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5), min_size=1, max_size=4))
def test_moments_of_parts_are_those_of_the_whole(parts):
    moments = RunningMoments()
    for part in parts:
        moments.add(torch.tensor(part, dtype=torch.float64))
    whole = np.concatenate(parts)
    assert float(moments.mean) == pytest.approx(whole.mean(), abs=1e-6)
    assert float(moments.variance) == pytest.approx(whole.var(), abs=1e-6)


def test_observations_are_scaled_and_clipped_or_left_alone():
    scaled, plain = ScaledObservations(1, 1.5, True), ScaledObservations(1, 1.5, False)
    for own in (scaled, plain):
        own.add(torch.tensor([[1.0], [5.0]]))  # mean 3, standard deviation 2
    shown = torch.tensor([[4.0], [3.0], [9.0]])
    torch.testing.assert_close(scaled(shown), torch.tensor([[0.5], [0.0], [1.5]]))
    torch.testing.assert_close(plain(shown), shown)


def test_rewards_are_scaled_by_the_spread_of_their_discounted_sums():
    """One environment, gamma 1/2: sums 2, 1 + 2 = 3 at an end; then 4. The step in vain counts nothing."""
    rewards = ScaledRewards(1, 0.5, 1.2, True)
    rewards.start()
    given = np.array([[2.0], [2.0], [0.0], [4.0]])
    ended, vain = np.array([[False], [True], [False], [False]]), np.array([[False], [False], [True], [False]])
    spread = np.std([2.0, 3.0, 4.0])
    found = rewards.scale(given, ended, vain)
    torch.testing.assert_close(found[0, 0], torch.tensor(1.2))  # 2 / 0.816 is beyond the limit
    assert float(rewards.moments.variance) == pytest.approx(spread**2)
    unscaled = ScaledRewards(1, 0.5, 1.2, False).scale(given, ended, vain)
    np.testing.assert_array_equal(unscaled.numpy(), given)


def test_advantages_by_hand():
    """gamma 1/2, lambda 1/2, rewards 1, values 2; next values 2, 8 at the end.

    First environment: cut by time at step 1, so the value 8 behind it counts. delta_1 = 1 + 4 - 2 = 3,
    delta_0 = 1 + 1 - 2 = 0: A_1 = 3, A_0 = 0 + 1/4 3. Step 2 is of a new episode: 1 + 1 - 2 = 0.
    Second: terminated there, so it does not. delta_1 = 1 - 2 = -1: A_0 = -1/4.
    """
    values = torch.full((3, 2), 2.0)
    following = torch.tensor([[2.0, 2.0], [8.0, 8.0], [2.0, 2.0]])
    ended = torch.tensor([[False, False], [True, True], [False, False]])
    terminated = ended & torch.tensor([False, True])
    found = advantages_of(torch.ones(3, 2), values, following, terminated, ended, 0.5, 0.5)
    torch.testing.assert_close(found, torch.tensor([[0.75, -0.25], [3.0, -1.0], [0.0, 0.0]]))


def make_learner(**changes):
    config = PpoConfig(hidden=(), scale_advantages=False, **changes)
    networks = ActorCritic(1, LOW, HIGH, config)
    with torch.no_grad():
        for parameter in networks.parameters():
            parameter.zero_()
    return PpoLearner(networks, config)


def sample(**changes):
    """One sample at the mean of the actor, whose density was half as large when it was drawn."""
    density = -0.5 * math.log(2 * math.pi)
    own = {
        "observations": [[0.0]], "actions": [[0.0]], "densities": [density - math.log(2.0)], "values": [0.0],
        "advantages": [1.0], "returns": [3.0],
    }  # fmt: skip
    return Samples(**{name: torch.tensor(value) for name, value in (own | changes).items()})


@pytest.mark.parametrize(("advantage", "policy"), [(1.0, -1.2), (-1.0, 2.0)])
def test_a_ratio_of_two_is_clipped_where_that_is_the_smaller_gain(advantage, policy):
    loss, logged = make_learner().loss(sample(advantages=[advantage]))
    assert logged["loss/policy"] == pytest.approx(policy)
    assert logged["loss/value"] == pytest.approx(9.0)
    assert logged["ppo/clipped"] == 1.0
    assert logged["ppo/divergence"] == pytest.approx(2.0 - 1.0 - math.log(2.0))
    assert loss.item() == pytest.approx(policy + 0.5 * 9.0)


@pytest.mark.parametrize(("old", "value"), [(-1.0, 12.25), (0.0, 9.0), (2.0, 9.0)])
def test_a_value_is_not_drawn_further_than_its_limit(old, value):
    """The value is 0 and is to be 3. From -1 it may come to -0.5, whose square 3.5^2 counts; from 2 to 1.5."""
    _, logged = make_learner(value_clip=0.5).loss(sample(values=[old]))
    assert logged["loss/value"] == pytest.approx(value)


def test_entropy_is_that_of_a_gaussian():
    learner = make_learner(entropy_weight=0.1)
    entropy = 0.5 * math.log(2 * math.pi * math.e)
    assert learner.networks.entropy().item() == pytest.approx(entropy)
    loss, _ = learner.loss(sample())
    assert loss.item() == pytest.approx(-1.2 + 4.5 - 0.1 * entropy)


def test_an_update_stops_where_the_policy_has_moved_too_far():
    learner = make_learner(divergence_limit=0.2, minibatch=1)
    before = {name: value.clone() for name, value in learner.networks.state_dict().items()}
    logged = learner.update(sample(), [torch.tensor([0])])  # its divergence 0.307 is above 0.3
    assert learner.updates == 0
    assert all(torch.equal(value, before[name]) for name, value in learner.networks.state_dict().items())
    assert math.isnan(logged["ppo/gradient"])
    assert tuple(logged) == learner.logged


def test_actions_are_clipped_before_they_are_scaled_to_the_limits():
    networks = make_learner().networks
    found = networks.to_environment(torch.tensor([[-3.0], [0.0], [0.5], [2.0]]))
    assert found[:, 0].tolist() == [-2.0, 1.0, 2.5, 4.0]


def test_explained_variance_by_hand():
    returns = torch.tensor([0.0, 2.0, 4.0])
    assert explained_variance(returns, returns) == 1.0
    assert explained_variance(torch.zeros(3), returns) == 0.0
    assert explained_variance(returns / 2, returns) == pytest.approx(0.75)
    assert math.isnan(explained_variance(returns, torch.ones(3)))


def test_episodes_are_counted_whenever_they_end():
    costs = EpisodeCosts(2)
    costs.start()
    ended = np.array([[False, False], [True, False], [False, False]])
    assert costs.add(np.full((3, 2), -1.0), ended) == 1
    assert costs.ended.tolist() == [True, False]
    assert costs.add(np.full((2, 2), -2.0), np.array([[True, False], [False, True]])) == 2
    assert costs.finished == [2.0, 3.0, 7.0]
    assert costs.ended.all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"steps": 0}, "steps = 0; give a value above 0"),
        ({"value_clip": -1.0}, "value_clip = -1.0; give a value above 0"),
        ({"trace_decay": 1.5}, r"trace_decay = 1.5; give a value in \[0, 1\]"),
        ({"entropy_weight": -1.0}, "entropy_weight = -1.0; give 0 or more"),
        ({"log_sigma": 3.0}, r"log_sigma = 3.0; give a value in \[-20, 2\]"),
        ({"hidden": (64, 0)}, r"hidden = \[64, 0\]; give values above 0"),
    ],
)
def test_settings_out_of_range_are_named(changes, said):
    with pytest.raises(BaselineConfigError, match=said):
        PpoConfig(**changes).check()

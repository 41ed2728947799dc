"""The learned value of actions: against values worked out by hand, and what it gives to learn from."""

import copy

import numpy as np
import pytest
import torch

from deepkoco.agent.action_value import ActionValue, ActionValueConfig, ActionValueError
from deepkoco.agent.config import TrainingConfig, TrainingConfigError
from deepkoco.agent.learner import Learner
from deepkoco.koopman import ModelConfig
from deepkoco.koopman.losses import ChunkBatch

LIMITS = np.array([-1.0]), np.array([1.0])


def line_batch(generator: torch.Generator) -> ChunkBatch:
    """A point that an action moves by itself, o' = clip(o + a, 0, 4), and that pays o for every step."""
    length, chunks = 12, 8
    actions = torch.rand(chunks, length, 1, generator=generator) * 2.0 - 1.0
    o, seen = torch.rand(chunks, 1, generator=generator) * 4.0, []
    for k in range(length):
        seen.append(o)
        o = (o + actions[:, k]).clamp(0.0, 4.0)
    observations = torch.stack(seen, 1)
    return ChunkBatch(observations, actions, observations[..., 0].clone(), torch.ones(chunks, length - 3))


def make_value(**changes) -> ActionValue:
    torch.manual_seed(1)
    settings = {"discount": 0.5, "hidden": (32, 32), "samples": 12, "learning_rate": 3e-3} | changes
    return ActionValue(1, *LIMITS, ActionValueConfig(**settings))


@pytest.fixture(scope="module")
def learned() -> ActionValue:
    value, generator = make_value(), torch.Generator().manual_seed(2)
    for _ in range(1500):
        value.update(line_batch(generator))
    return value


def test_values_are_those_of_the_best_actions_to_come(learned):
    # From o = 2.5 with a: 2.5, then 2.5 + a, and from there one less at every step with a = -1, down to 0.
    # a = -1: 1/2 (2.5 + 1.5/2 + 0.5/4) = 1.6875; a = 0: 1/2 (2.5 + 2.5/2 + 1.5/4 + 0.5/8) = 2.09375
    # a = 1: 1/2 (2.5 + 3.5/2 + 2.5/4 + 1.5/8 + 0.5/16) = 2.546875
    observations, actions = torch.full((3, 1), 2.5), torch.tensor([[-1.0], [0.0], [1.0]])
    expected = torch.tensor([1.6875, 2.09375, 2.546875])
    torch.testing.assert_close(learned.value(observations, actions), expected, rtol=0.0, atol=0.12)


def test_the_policy_that_made_the_data_is_forgotten(learned):
    # Actions at random leave o = 2 where it is on average: its own mean of the costs to come would be near 2.
    best = learned.value(torch.tensor([[2.0]]), torch.tensor([[-1.0]])).item()
    assert best == pytest.approx(0.5 * (2.0 + 1.0 / 2.0), abs=0.12)


def test_labels_are_values_of_the_actions_applied_and_of_others(learned):
    batch = line_batch(torch.Generator().manual_seed(4))
    own, others = learned.labelled(batch)
    assert torch.equal(own.costs, learned.value(batch.observations, batch.actions))
    assert others is not None
    assert torch.equal(others.costs, learned.value(batch.observations, others.actions))
    assert (others.actions.min(), others.actions.max()) == pytest.approx((-1.0, 1.0), abs=0.1)
    assert not torch.equal(others.actions, batch.actions)


def test_steps_outside_of_every_window_teach_nothing():
    value, batch = make_value(), line_batch(torch.Generator().manual_seed(4))
    batch.window_weights[:, 5:] = 0.0
    batch.costs[:, 5:], batch.observations[:, 7:] = torch.nan, torch.nan
    assert np.isfinite(value.update(batch))


def make_learner(**changes) -> Learner:
    torch.manual_seed(3)
    settings = ActionValueConfig(**({"discount": 0.9, "hidden": (8,)} | changes))
    config = TrainingConfig(model=ModelConfig(2, 0.05, (8, 8), (8,)), horizon=3, value=settings)
    return Learner(1, 1, config, LIMITS)


def test_a_restored_learner_with_a_value_goes_on_bit_for_bit():
    one, batch = make_learner(), line_batch(torch.Generator().manual_seed(4))
    one.update(batch)
    other = make_learner()
    other.load_state_dict(copy.deepcopy(one.state_dict()))
    for _ in range(3):
        assert one.update(batch).total == other.update(batch).total
    for own, theirs in zip(one.averaged.parameters(), other.averaged.parameters(), strict=True):
        assert torch.equal(own, theirs)


def test_without_a_value_a_state_names_none():
    torch.manual_seed(3)
    assert "value" not in Learner(1, 1, TrainingConfig(), LIMITS).state_dict()


def test_frames_and_missing_limits_are_refused():
    config = TrainingConfig(value=ActionValueConfig(discount=0.9))
    for observation, limits in ((1, None), ((32, 32, 3), LIMITS)):
        with pytest.raises(TrainingConfigError, match=r"value\.discount"):
            Learner(observation, 1, config, limits)


@pytest.mark.parametrize(
    "changes", [{"discount": 1.0}, {"discount": -0.1}, {"samples": 0}, {"following": 2.0}]
)
def test_settings_out_of_range_are_named(changes):
    with pytest.raises(ActionValueError, match=next(iter(changes))):
        TrainingConfig(value=ActionValueConfig(**changes)).check()


def test_two_costs_to_come_are_refused():
    with pytest.raises(TrainingConfigError, match="cost_discount"):
        TrainingConfig(value=ActionValueConfig(discount=0.9), cost_discount=0.9).check()

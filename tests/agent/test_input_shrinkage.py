"""Weights of entries of the observation that the cost does not need go to nothing."""

import math

import pytest
import torch

from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.input_shrinkage import FREE, START, InputShrinkage
from deepkoco.agent.learner import Learner
from deepkoco.koopman.losses import ChunkBatch
from deepkoco.koopman.model.model import KoopmanModel, ModelConfig

SMALL = ModelConfig(2, 0.05, (12, 8), (8,))
FREE_NORM = FREE * math.sqrt(12 / (3 * 4))  # 12 hidden units see 3 entries and 1 action


def first_layer(model: KoopmanModel) -> torch.Tensor:
    return model.encoder.network.linears[0].weight.detach()


def with_norms(*norms: float) -> tuple[KoopmanModel, InputShrinkage]:
    """A model whose entries have weights of these norms, and a shrinkage of two step sizes."""
    torch.manual_seed(0)
    model = KoopmanModel(3, 1, SMALL)
    shrinkage = InputShrinkage(model, 2.0)
    weights = first_layer(model)[:, :3]
    weights.mul_(torch.tensor(norms) / weights.norm(dim=0))
    return model, shrinkage


def test_a_small_group_loses_what_the_penalty_says_and_none_turns_its_sign():
    model, shrinkage = with_norms(0.5 * FREE_NORM, FREE_NORM, 1e-3)
    shrinkage.step(0.01)
    # Half way to the free norm: 2 steps of 0.01, half of it. At the free norm: nothing. Below the length: all.
    expected = torch.tensor([0.5 * FREE_NORM - 0.01, FREE_NORM, 0.0])
    torch.testing.assert_close(first_layer(model)[:, :3].norm(dim=0), expected)


def test_a_group_shrinks_without_turning_and_actions_keep_their_weights():
    model, shrinkage = with_norms(0.5 * FREE_NORM, 1.0, 1.0)
    before = first_layer(model).clone()
    shrinkage.step(0.01)
    after = first_layer(model)
    torch.testing.assert_close(after[:, 0] / after[:, 0].norm(), before[:, 0] / before[:, 0].norm())
    assert torch.equal(after[:, 1:], before[:, 1:])


def test_only_entries_start_small():
    models = []
    for strength in (0.0, 1.0):
        torch.manual_seed(0)
        models.append(KoopmanModel(3, 1, SMALL))
        InputShrinkage(models[-1], strength)
    plain, small = map(first_layer, models)
    torch.testing.assert_close(small[:, :3], START * plain[:, :3])
    assert torch.equal(small[:, 3:], plain[:, 3:])


def test_frames_are_no_entries_to_choose_from():
    torch.manual_seed(0)
    model = KoopmanModel((64, 64, 3), 1, SMALL)
    before = first_layer(model).clone()
    InputShrinkage(model, 1.0).step(1.0)
    assert torch.equal(first_layer(model), before)


def moved_by_one_action(entries: int) -> ChunkBatch:
    """Entries that wander; the action moves entry 1 alone, whose square is the cost."""
    generator = torch.Generator().manual_seed(1)
    actions = torch.randn(400, 10, 1, generator=generator)
    seen = torch.randn(400, 10, entries, generator=generator)
    for k in range(9):
        seen[:, k + 1] = 0.95 * seen[:, k] + 0.3 * seen[:, k + 1]
        seen[:, k + 1, 1] = 0.95 * seen[:, k, 1] + 0.3 * actions[:, k, 0]
    return ChunkBatch(seen, actions, seen[..., 1] ** 2, torch.ones(400, 6))


@pytest.mark.parametrize("unit", [1.0, 20.0])
def test_the_entry_that_the_cost_needs_is_found_in_any_unit_of_the_cost(unit):
    torch.manual_seed(0)
    model = ModelConfig(2, 0.05, (24, 24), (12,))
    config = TrainingConfig(model=model, horizon=4, learning_rate=3e-3, input_shrinkage=1.0)
    learner, all_ = Learner(6, 1, config), moved_by_one_action(6)
    for drawn in torch.randperm(400).split(20) * 15:
        costs = unit * all_.costs[drawn]
        learner.update(
            ChunkBatch(all_.observations[drawn], all_.actions[drawn], costs, all_.window_weights[drawn])
        )
    norms = first_layer(learner.model)[:, :6].norm(dim=0)
    assert norms[1] > 5.0 * torch.cat((norms[:1], norms[2:])).max()

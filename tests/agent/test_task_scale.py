"""Units of learning: what is found, and that an exported model is the same function in the task's own units."""

import dataclasses

import numpy as np
import pytest
import torch

from deepkoco.agent.buffer import Episode
from deepkoco.agent.discounting import discounted_mean
from deepkoco.agent.task_scale import MEAN_COST, TaskScale, lowest_cost, with_end
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.model.cost import quadratic_cost
from deepkoco.planning import PlannerConfig

LOW, HIGH = np.array([-10.0, -2.0]), np.array([10.0, 2.0])


def episode(costs, steps=50, final=None) -> Episode:
    generator = np.random.default_rng(3)
    observations = generator.normal([5.0, 0.0, 1.0], [0.01, 30.0, 0.0], (steps, 3))
    actions = generator.uniform(LOW, HIGH, (steps, 2))
    parts = (torch.tensor(part).float() for part in (observations, actions, np.broadcast_to(costs, steps)))
    return Episode(*parts, final)


def test_learning_sees_standardised_observations_actions_in_quarters_of_their_range_and_a_fixed_mean_cost():
    recorded = episode(np.linspace(0.0, 200.0, 50))
    learned = TaskScale.of([recorded], LOW, HIGH).apply(recorded, 15)
    np.testing.assert_allclose(
        learned.observations.mean(0), [0.0, 0.0, 1.0], atol=1e-3
    )  # the last one never moves
    np.testing.assert_allclose(learned.observations.std(0, correction=0)[:2], 1.0, rtol=1e-3)
    np.testing.assert_allclose(learned.actions, recorded.actions / torch.tensor([5.0, 1.0]))
    assert learned.costs.mean().item() == pytest.approx(MEAN_COST, rel=1e-5)


@pytest.mark.parametrize("decoder", [(), (8,)])
def test_a_folded_model_is_the_same_function_in_the_units_of_the_task(decoder):
    torch.manual_seed(0)
    model = KoopmanModel(3, 2, ModelConfig(2, 0.05, (8,), (8,), decoder_hidden=decoder)).double()
    recorded = episode(np.linspace(0.0, 200.0, 50))
    scale = dataclasses.replace(TaskScale.of([recorded], LOW, HIGH), action=np.array([3.0, 3.0]))
    learned, folded = scale.apply(recorded, 15), scale.fold(export_model(model))
    o, a = learned.observations.double(), learned.actions.double()
    latent, matrix, factor = model.linearise(o, a)
    cost = quadratic_cost(factor, latent[:, None], a[:, None], model.config.action_weight).squeeze(1)

    rows, own_factor = folded.linearise(
        recorded.observations.double().numpy(), recorded.actions.double().numpy()
    )
    np.testing.assert_allclose(rows[:, 0], latent.detach(), atol=1e-4)  # observations are stored as float32
    np.testing.assert_allclose(rows[:, 1:], matrix.mT.detach() / 3.0, atol=1e-6)
    roots = (own_factor @ rows[:, 0, :, None])[..., 0]
    own_cost = np.square(roots).sum(-1) + folded.action_weight * np.square(
        recorded.actions.double().numpy()
    ).sum(-1)
    np.testing.assert_allclose(own_cost, scale.cost * cost.detach().numpy(), rtol=1e-3)
    if decoder:
        pseudo = model.decoder(latent).detach().numpy() * scale.spread + scale.mean
        np.testing.assert_allclose(folded.decode(latent.detach().numpy()), pseudo, rtol=1e-6)


def test_weights_of_actions_mean_the_same_whatever_the_units():
    # A task in other units: 5 times the force, 7 times the cost. R~ da^2 must make the same share of the cost.
    scale = TaskScale.of([episode(np.linspace(0.0, 20.0, 50))], np.array([-1.0]), np.array([1.0]))
    other = TaskScale.of([episode(np.linspace(0.0, 140.0, 50))], np.array([-5.0]), np.array([5.0]))
    weights = [s.planner(PlannerConfig(increment_weight=0.01)).increment_weight for s in (scale, other)]
    assert weights[1] / weights[0] == pytest.approx(7.0 / 25.0, rel=1e-5)


def test_a_task_that_pays_for_every_step_loses_what_its_end_costs():
    ended, cut = episode(-1.0, 5, torch.tensor([9.0, 9.0, 9.0])), episode(-1.0, 5)
    scale = TaskScale.of([ended, cut], LOW, HIGH)
    assert scale.lowest == -1.0
    learned = scale.apply(ended, 4)
    # Five steps that pay all there is cost 0; four that follow the end, at the last observation, cost 1 unit each.
    np.testing.assert_allclose(learned.costs * scale.cost, [0.0] * 5 + [1.0] * 4, rtol=1e-5)
    assert torch.equal(learned.actions[5:], learned.actions[4:5].expand(4, 2))
    assert scale.apply(cut, 4).costs.numel() == 5


def test_a_task_that_only_costs_and_a_rare_bonus_stay_as_they_are():
    assert with_end(episode(1.0, 5, torch.zeros(3)), lowest_cost([episode(1.0)]), 4).costs.numel() == 5
    bonus = np.zeros(50)
    bonus[-1] = -100.0
    assert lowest_cost([episode(bonus)]) == 0.0


def test_a_scale_is_the_same_after_a_checkpoint():
    scale = TaskScale.of([episode(np.linspace(0.0, 3.0, 50))], LOW, HIGH)
    again = TaskScale.from_state(scale.state_dict())
    for field in dataclasses.fields(TaskScale):
        np.testing.assert_array_equal(getattr(scale, field.name), getattr(again, field.name))


def test_a_rare_bonus_is_learned_as_costs_to_come_that_an_end_continues():
    costs = np.zeros(50)
    costs[-1] = -100.0
    recorded = episode(costs, final=torch.zeros(3))
    scale = TaskScale.of([recorded], LOW, HIGH, discount=0.9)
    learned = scale.apply(recorded, 15).costs
    assert learned.numel() == 65
    # (1 - gamma) 100 gamma^k, k steps before the goal, above the best of them: 10 (1 - 0.9^k).
    expected = 10.0 * (1.0 - 0.9 ** np.arange(49, -1, -1)) / scale.cost
    np.testing.assert_allclose(learned[:50], expected, atol=1e-5)
    np.testing.assert_allclose(learned[50:], 0.0, atol=1e-5)
    assert scale.lowest == pytest.approx(-10.0)


def test_costs_to_come_of_a_task_that_pays_for_every_step_count_from_its_best_step():
    recorded = episode(-1.0, final=torch.zeros(3))
    scale = TaskScale.of([recorded], LOW, HIGH, discount=0.9)
    assert scale.lowest == -1.0  # no mean of steps is below, however long later episodes are
    learned = scale.apply(recorded, 15).costs * scale.cost
    np.testing.assert_allclose(learned[:50], 0.9 ** np.arange(50, 0, -1), atol=1e-5)
    np.testing.assert_allclose(learned[50:], 0.9, atol=1e-5)


def test_units_of_steps_are_those_without_a_discount():
    recorded = episode(np.linspace(0.0, 200.0, 50))
    plain, far = (TaskScale.of([recorded], LOW, HIGH, discount=discount) for discount in (0.0, 0.9))
    assert far.cost != plain.cost
    assert far.of_steps.state_dict() == plain.state_dict()
    assert TaskScale.from_state(far.state_dict()).state_dict() == far.state_dict()


def test_linear_models_are_given_the_price_of_actions_with_the_costs_to_come():
    recorded = episode(np.linspace(0.0, 200.0, 50))
    charged = np.array([0.5, 2.0])
    scale = TaskScale.of([recorded], LOW, HIGH, charged, discount=0.9)
    price = (recorded.actions.double().square() @ torch.from_numpy(charged)).float()
    state = dataclasses.replace(recorded, costs=recorded.costs - price)
    expected = discounted_mean(state.costs, 0.9) + price
    torch.testing.assert_close(scale.with_costs_to_come(recorded).costs, expected, rtol=1e-4, atol=1e-4)


def test_one_cost_that_is_not_finite_leaves_the_units_of_costs_to_come_and_the_steps_before_it_as_they_are():
    costs = np.linspace(-1.0, 1.0, 50)
    broken = costs.copy()
    broken[20] = np.nan
    whole, part = (
        TaskScale.of([episode(-2.0, 10), episode(c)], LOW, HIGH, discount=0.9) for c in (costs, broken)
    )
    assert part.lowest == pytest.approx(whole.lowest, rel=0.1)
    assert part.cost == pytest.approx(whole.cost, rel=0.1)
    learned = part.apply(episode(broken), 15).costs
    assert learned.isfinite().all()
    # The best mean counts as 0, also where it is in an episode with an unknown cost.
    paid = TaskScale.of(
        [episode(1.0), episode(np.where(np.isnan(broken), np.nan, -3.0))], LOW, HIGH, discount=0.9
    )
    assert paid.lowest == pytest.approx(-3.0)

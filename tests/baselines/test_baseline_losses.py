"""Every term of every loss against a case worked out by hand, and where its gradients go."""

import copy

import numpy as np
import pytest
import torch
from scipy.stats import norm
from tracking import FRAME, small

from baselines.dbc import code_bisimulation, paper_bisimulation
from baselines.decoder import decoder_target
from baselines.encoders import as_input
from baselines.latent_models import TRANSITIONS, Prediction, transition_loss
from baselines.registry import make_learner
from baselines.replay import Batch


def a_batch(shape=(1,), size=8, action_size=1, seed=0):
    g = torch.Generator().manual_seed(seed)
    if len(shape) == 1:
        o, following = (torch.randn(size, *shape, generator=g) for _ in range(2))
    else:
        stacked = (size, shape[0], shape[1], 9)
        o, following = (
            as_input(torch.randint(256, stacked, dtype=torch.uint8, generator=g)) for _ in range(2)
        )
    actions = torch.rand(size, action_size, generator=g) * 2 - 1
    return Batch(o, actions, torch.randn(size, generator=g), torch.ones(size), following)


def constant_sac(values=(3.0, 5.0)):
    """SAC with mu = 0, log sigma = -4 (the middle of [-10, 2]), Q_1 and Q_2 constant, alpha = 0.1."""
    torch.manual_seed(0)
    sac = make_learner((1,), 1, small("sac"))
    with torch.no_grad():
        sac.actor.trunk[-1].weight.zero_()
        for critic in (sac.critic, sac.target):
            for twin, value in zip(critic.twins, values, strict=True):
                twin[-1].weight.zero_()
                twin[-1].bias.fill_(value)
    return sac


def log_density(noise):
    u = np.exp(-4.0) * noise
    return norm.logpdf(u, 0.0, np.exp(-4.0)) - np.log(1.0 - np.tanh(u) ** 2)


def test_critic_target():
    sac = constant_sac()
    batch = Batch(
        torch.zeros(2, 1),
        torch.zeros(2, 1),
        torch.tensor([1.0, 2.0]),
        torch.tensor([1.0, 0.0]),
        torch.zeros(2, 1),
    )
    target = sac.critic_target(batch, torch.tensor([[0.5], [1.0]]))
    # The second transition terminated: y = r.
    expected = [1.0 + 0.99 * (3.0 - 0.1 * log_density(0.5)), 2.0]
    np.testing.assert_allclose(target.numpy(), expected, rtol=1e-5)
    assert not target.requires_grad


def test_critic_loss_is_the_sum_of_both_mean_squares():
    sac = constant_sac()
    batch = a_batch(size=2)
    loss, _ = sac.critic_loss(batch, torch.tensor([1.0, 4.0]))
    # ((3-1)^2 + (3-4)^2) / 2 + ((5-1)^2 + (5-4)^2) / 2 = 2.5 + 8.5
    assert loss.item() == pytest.approx(11.0)


def test_actor_and_temperature_loss():
    sac = constant_sac()
    loss, density = sac.actor_loss(a_batch(size=2), torch.tensor([[0.5], [-1.0]]))
    expected = np.array([log_density(0.5), log_density(-1.0)])
    np.testing.assert_allclose(density.numpy(), expected, rtol=1e-5)
    assert loss.item() == pytest.approx((0.1 * expected - 3.0).mean(), rel=1e-5)
    # alpha (-log pi - (-1))
    assert sac.temperature_loss(density).item() == pytest.approx((0.1 * (-expected + 1.0)).mean(), rel=1e-5)


def test_transition_loss():
    mean, target = torch.tensor([[1.0, 2.0]]), torch.tensor([[0.0, 4.0]])
    # (1^2 + 2^2) / 2 / 2 entries
    assert transition_loss(Prediction(mean, None), target).item() == pytest.approx(1.25)
    # [(1/2)^2 / 2 + log 2 + (2/4)^2 / 2 + log 4] / 2
    sigma = torch.tensor([[2.0, 4.0]])
    expected = (0.125 + np.log(2) + 0.125 + np.log(4)) / 2
    assert transition_loss(Prediction(mean, sigma), target).item() == pytest.approx(expected)
    # Two members of an ensemble, the second exact with sigma = 1: its loss is 0.
    both = Prediction(torch.stack((mean, target)), torch.stack((sigma, torch.ones(1, 2))))
    assert transition_loss(both, target).item() == pytest.approx(expected / 2)


LATENTS = torch.tensor([[0.0, 0.5], [3.0, 0.0]])
REWARDS = torch.tensor([1.0, 3.0])
PREDICTED = Prediction(torch.tensor([[0.0, 1.0], [3.0, 1.0]]), torch.tensor([[1.0, 2.0], [5.0, 2.0]]))
OTHER = torch.tensor([1, 0])


def test_code_bisimulation_and_its_gradient():
    latents = LATENTS.clone().requires_grad_()
    loss = code_bisimulation(latents, REWARDS, PREDICTED, OTHER, 0.5)
    # Smooth absolute values: of 3: 2.5, of 0.5: 0.125, of the rewards' 2: 1.5.
    # Gaussians: sqrt(3^2 + 4^2) = 5 and 0. Both transitions give the same: (2.5 - 1.5 - 2.5)^2, (0.125 - 1.5)^2.
    a, b = 2.5 - 1.5 - 2.5, 0.125 - 1.5
    assert loss.item() == pytest.approx((a**2 + b**2) / 2)
    loss.backward()
    # Of entry 0: two terms, each (1/4) 2 a s'(+-3) and s' = +-1; z_i and z_j both move.
    np.testing.assert_allclose(latents.grad.numpy(), [[-a, 0.5 * b], [a, -0.5 * b]], rtol=1e-6)


def test_paper_bisimulation_and_its_gradient():
    latents = LATENTS.clone().requires_grad_()
    loss = paper_bisimulation(latents, REWARDS, PREDICTED, OTHER, 0.5)
    # |z_i - z_j|_1 = 3.5, |r_i - r_j| = 2, W2 = sqrt(3^2 + 4^2) = 5.
    difference = 3.5 - 2.0 - 2.5
    assert loss.item() == pytest.approx(difference**2)
    loss.backward()
    # Two terms, each (1/2) 2 d sign.
    slope = 2 * difference
    np.testing.assert_allclose(latents.grad.numpy(), [[-slope, slope], [slope, -slope]], rtol=1e-6)


def test_deterministic_transition_compares_means_only():
    predicted = Prediction(PREDICTED.mean, None)
    # W2 = 3: (3.5 - 2 - 1.5)^2
    assert paper_bisimulation(LATENTS, REWARDS, predicted, OTHER, 0.5).item() == pytest.approx(0.0)
    # (2.5 - 1.5 - 1.5)^2, (0.125 - 1.5)^2
    expected = (0.25 + 1.375**2) / 2
    assert code_bisimulation(LATENTS, REWARDS, predicted, OTHER, 0.5).item() == pytest.approx(expected)


@pytest.mark.parametrize("loss", [code_bisimulation, paper_bisimulation])
def test_an_ensemble_of_equal_members_is_one_of_them(loss):
    ensemble = Prediction(torch.stack([PREDICTED.mean] * 5), torch.stack([PREDICTED.sigma] * 5))
    arguments = (OTHER, 0.5)
    one = loss(LATENTS, REWARDS, PREDICTED, *arguments)
    torch.testing.assert_close(loss(LATENTS, REWARDS, ensemble, *arguments), one)


@pytest.mark.parametrize("variant", ["code", "paper"])
@pytest.mark.parametrize("transition", list(TRANSITIONS))
def test_the_right_of_the_bisimulation_has_no_gradient(variant, transition):
    torch.manual_seed(0)
    dbc = make_learner((1,), 1, small("dbc", variant=variant, transition=transition))
    batch = a_batch()
    features = dbc.critic.body(batch.observations)
    latents = dbc.critic.head(features)
    predicted = dbc.transition(latents, batch.actions)
    rewards, behaviour = dbc._variant.evidence(dbc, batch, features.detach(), latents.detach(), predicted)
    assert not rewards.requires_grad
    assert not behaviour.mean.requires_grad
    assert behaviour.sigma is None or not behaviour.sigma.requires_grad
    loss = dbc._variant.loss(latents, rewards, behaviour, torch.randperm(8), 0.99)
    loss.backward()
    assert all(p.grad is None for m in (dbc.transition, dbc.reward, dbc.actor) for p in m.parameters())
    assert all(p.grad.abs().sum() > 0 for p in dbc.critic.body.parameters())


def test_paper_variant_compares_the_models_at_the_mean_action():
    torch.manual_seed(0)
    dbc = make_learner((1,), 1, small("dbc", variant="paper"))
    batch = a_batch()
    features = dbc.critic.body(batch.observations)
    latents = dbc.critic.head(features)
    rewards, behaviour = dbc.policy_evidence(batch, features, latents, None)
    expected = dbc.transition(latents, torch.tanh(dbc.actor(features)[0]))
    torch.testing.assert_close(behaviour.mean, expected.mean)
    torch.testing.assert_close(behaviour.sigma, expected.sigma)
    torch.testing.assert_close(rewards, dbc.reward(expected.mean))


def changed(before, after):
    return {name for name in before if not torch.equal(before[name], after[name])}


def weights(learner):
    parts = {
        "actor": learner.actor,
        "body": learner.critic.body,
        "head": learner.critic.head,
        "twins": learner.critic.twins,
    }
    for name in ("transition", "reward", "decoder"):
        if getattr(learner, name, None) is not None:
            parts[name] = getattr(learner, name)
    return {k: torch.cat([p.detach().flatten() for p in m.parameters()]).clone() for k, m in parts.items()}


@pytest.mark.parametrize("name", ["sac_shared", "deepmdp", "dbc"])
@pytest.mark.parametrize("shape", [(1,), FRAME])
def test_each_step_trains_what_it_should(name, shape):
    torch.manual_seed(0)
    learner = make_learner(shape, 1, small(name, actor_every=1))
    sac = getattr(learner, "sac", learner)
    batch, g = a_batch(shape), torch.Generator().manual_seed(0)
    start = weights(learner)
    sac.updates += 1
    sac.update_critic(batch, g)
    critic = weights(learner)
    assert changed(start, critic) == {"body", "head", "twins"}
    sac.update_actor(batch, g)
    actor = weights(learner)
    assert changed(critic, actor) == {"actor"}
    if name == "sac_shared":
        return
    learner.update_models(batch, *([g] if name == "dbc" else []))
    models = weights(learner)
    assert changed(actor, models) == {"body", "head", "transition", "reward"}
    if name == "deepmdp" and len(shape) == 3:
        learner.update_decoder(batch, g)
        assert changed(models, weights(learner)) == {"body", "head", "transition", "decoder"}


def test_separate_encoder_of_plain_sac_is_trained_by_the_actor():
    torch.manual_seed(0)
    sac = make_learner(FRAME, 1, small("sac", actor_every=1))
    before = copy.deepcopy(sac.actor.body.state_dict())
    critic = weights(sac)
    sac.updates += 1
    sac.update_actor(a_batch(FRAME), torch.Generator().manual_seed(0))
    assert changed(before, sac.actor.body.state_dict())
    assert not changed(critic, weights(sac)) - {"actor"}


def test_a_sampled_latent_carries_the_gradient_of_the_reward():
    torch.manual_seed(0)
    for name, kind in TRANSITIONS.items():
        transition = kind(3, 1)
        predicted = transition(torch.randn(4, 3), torch.randn(4, 1))
        transition.sample(predicted, torch.Generator().manual_seed(1)).sum().backward()
        moved = [n for n, p in transition.named_parameters() if p.grad is not None and p.grad.abs().sum() > 0]
        assert len(moved) == len(list(transition.parameters())) or name == "ensemble"
        assert moved


def test_decoder_target_is_the_oldest_frame_in_32_levels():
    frames = torch.zeros(1, 2, 2, 9, dtype=torch.uint8)
    frames[0, :, :, 0] = torch.tensor([[0, 7], [8, 255]])
    frames[..., 3:] = 77
    target = decoder_target(as_input(frames), torch.Generator().manual_seed(0))
    assert target.shape == (1, 3, 2, 2)
    # Levels 0, 0, 1 and 31, each spread over its 1/32 by the dither.
    levels = torch.floor((target[0, 0] + 0.5) * 32)
    assert levels.tolist() == [[0.0, 0.0], [1.0, 31.0]]
    assert target.min() >= -0.5
    assert target.max() < 0.5
    assert len(target[0, 1].unique()) == 4


def test_decoder_loss():
    torch.manual_seed(0)
    learner = make_learner(FRAME, 1, small("deepmdp"))
    with torch.no_grad():
        for p in learner.decoder.layers[-1].parameters():
            p.zero_()
    batch = a_batch(FRAME)
    logged = learner.update_decoder(batch, torch.Generator().manual_seed(3))
    # The decoder gives 0 everywhere.
    expected = decoder_target(batch.following, torch.Generator().manual_seed(3)).square().mean()
    assert logged["loss/decoder"] == pytest.approx(expected.item(), rel=1e-5)


def test_reward_losses():
    for name in ("deepmdp", "dbc"):
        torch.manual_seed(0)
        learner = make_learner((1,), 1, small(name))
        with torch.no_grad():
            learner.reward.layers[-1].weight.zero_()
            learner.reward.layers[-1].bias.fill_(2.0)
        batch = a_batch()
        arguments = [torch.Generator().manual_seed(0)] if name == "dbc" else []
        logged = learner.update_models(batch, *arguments)
        assert logged["loss/reward"] == pytest.approx((2.0 - batch.rewards).square().mean().item(), rel=1e-5)

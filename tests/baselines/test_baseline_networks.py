"""Starting weights, densities, shapes and moving targets."""

import numpy as np
import pytest
import torch
from scipy.stats import norm
from torch import nn
from tracking import small

from baselines.actor import squash
from baselines.config import BaselineConfigError
from baselines.decoder import PixelDecoder
from baselines.encoders import PixelBody, as_input
from baselines.initialisation import initialise
from baselines.latent_models import LARGEST_SIGMA, SMALLEST_SIGMA, ProbabilisticTransition
from baselines.optimisation import MovingTarget, descend, make_adam
from baselines.registry import make_learner
from baselines.replay import Batch


def test_linear_layers_start_orthogonal():
    layer = nn.Linear(20, 8)
    layer.apply(initialise)
    torch.testing.assert_close(layer.weight @ layer.weight.T, torch.eye(8))
    assert not layer.bias.any()


@pytest.mark.parametrize("layer", [nn.Conv2d(4, 6, 3), nn.ConvTranspose2d(6, 4, 3)])
def test_convolutions_start_delta_orthogonal(layer):
    layer.apply(initialise)
    middle = layer.weight[:, :, 1, 1].clone()
    # The gain of ReLU is sqrt(2), so the orthogonal matrix has W' W = 2 I.
    torch.testing.assert_close(middle.T @ middle, 2.0 * torch.eye(4))
    with torch.no_grad():
        layer.weight[:, :, 1, 1] = 0.0
    assert not layer.weight.any()
    assert not layer.bias.any()


def test_models_of_a_learner_start_as_said():
    torch.manual_seed(0)
    learner = make_learner((12, 12, 3), 2, small("deepmdp"))
    first = learner.critic.body.layers[0].weight
    assert not first[:, :, 0, 0].any()
    assert first[:, :, 1, 1].any()
    head = learner.actor.head[0].weight
    torch.testing.assert_close(head @ head.T, torch.eye(len(head)), atol=1e-5, rtol=0)


def test_log_density_is_that_of_the_squashed_gaussian():
    mean, log_sigma = torch.tensor([[0.3, -1.0]]), torch.tensor([[-0.5, 0.2]])
    noise = torch.tensor([[1.2, -0.4]])
    actions, density = squash(mean, log_sigma, noise)
    u = (mean + log_sigma.exp() * noise).double().numpy()
    expected = norm.logpdf(u, mean.numpy(), log_sigma.exp().numpy()) - np.log(1 - np.tanh(u) ** 2)
    np.testing.assert_allclose(actions.numpy(), np.tanh(u), rtol=1e-6)
    assert density.item() == pytest.approx(expected.sum(), rel=1e-5)


def test_log_density_is_finite_where_tanh_is_one():
    _, density = squash(torch.tensor([[30.0]]), torch.tensor([[-10.0]]), torch.zeros(1, 1))
    # log(1 - tanh^2 30) = 2 (log 2 - 30), and the Gaussian has log density 10 - log(2 pi) / 2.
    assert density.item() == pytest.approx(10 - 0.5 * np.log(2 * np.pi) - 2 * (np.log(2) - 30), rel=1e-5)


def test_sigma_stays_inside_its_limits():
    transition = ProbabilisticTransition(3, 1)
    for scale in (-1e6, 1e6):
        sigma = transition(torch.full((1, 3), scale), torch.zeros(1, 1)).sigma
        assert (sigma >= SMALLEST_SIGMA).all()
        assert (sigma <= LARGEST_SIGMA).all()


@pytest.mark.parametrize("shape", [(64, 64, 3), (17, 12, 3)])
def test_decoder_gives_frames_of_the_size_that_is_encoded(shape):
    body = PixelBody(shape, 3, (5, 4, 4), (2, 2, 1) if shape[0] == 64 else (2, 1, 1))
    frames = torch.randint(256, (2, *shape[:2], 9), dtype=torch.uint8)
    assert body(as_input(frames)).shape == (2, body.width)
    assert PixelDecoder(6, body)(torch.randn(2, 6)).shape == (2, 3, *shape[:2])


def test_published_sizes_of_the_convolutions():
    body = PixelBody((64, 64, 3), 3, (32,) * 4, (2, 1, 1, 1))
    assert body.sizes == [(64, 64), (31, 31), (29, 29), (27, 27), (25, 25)]
    assert body.width == 32 * 25 * 25


def test_too_many_convolutions_are_refused():
    with pytest.raises(BaselineConfigError, match="nothing is left of frames of 8 x 8"):
        PixelBody((8, 8, 3), 3, (4, 4, 4), (2, 2, 2))


def test_frames_are_scaled_and_keep_their_order():
    frames = torch.arange(2 * 2 * 2 * 9, dtype=torch.uint8).reshape(2, 2, 2, 9)
    seen = as_input(frames)
    assert seen.shape == (2, 9, 2, 2)
    assert seen[1, 4, 0, 1].item() == pytest.approx(frames[1, 0, 1, 4].item() / 255)


def test_targets_follow():
    module, target = nn.Linear(2, 2), nn.Linear(2, 2)
    expected = target.weight + 0.25 * (module.weight - target.weight)
    MovingTarget(module, target, 0.25).step()
    torch.testing.assert_close(target.weight, expected)


def test_critics_and_encoder_have_rates_of_their_own():
    torch.manual_seed(0)
    sac = make_learner((1,), 1, small("sac_shared", target_every=1))
    with torch.no_grad():
        for p in sac.target.parameters():
            p.zero_()
    sac.updates = 1
    sac.update_targets()
    torch.testing.assert_close(sac.target.twins[0][0].weight, 0.01 * sac.critic.twins[0][0].weight)
    torch.testing.assert_close(sac.target.body[0].weight, 0.05 * sac.critic.body[0].weight)
    torch.testing.assert_close(sac.target.head[0].weight, 0.05 * sac.critic.head[0].weight)


def test_actor_and_targets_move_at_every_second_update():
    torch.manual_seed(0)
    sac = make_learner((1,), 1, small("sac"))
    followed = (sac.actor.trunk[0].weight, sac.target.twins[0][0].weight)
    generator, moved = torch.Generator().manual_seed(0), []
    batch = Batch(torch.randn(8, 1), torch.zeros(8, 1), torch.randn(8), torch.ones(8), torch.randn(8, 1))
    for _ in range(4):
        before = [weight.clone() for weight in followed]
        sac.update(batch, generator)
        moved.append([not torch.equal(a, b) for a, b in zip(before, followed, strict=True)])
    assert moved == [[False, False], [True, True], [False, False], [True, True]]


def test_a_step_computes_no_gradient_for_what_it_does_not_train():
    a, b = nn.Linear(2, 2), nn.Linear(2, 1)
    descend(b(a(torch.randn(3, 2))).square().mean(), [make_adam(a.parameters(), 1e-3)])
    assert b.weight.grad is None
    assert a.weight.grad is not None

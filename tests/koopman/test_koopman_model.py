"""The start of training."""

import torch

from deepkoco.koopman.model.model import KoopmanModel, ModelConfig


def test_predicted_root_cost_starts_with_one_sign_over_the_state_space():
    for seed in range(5):
        torch.manual_seed(seed)
        model = KoopmanModel(3, 1, ModelConfig())
        angle = (torch.rand(2000) * 2 - 1) * torch.pi
        speed = (torch.rand(2000) * 2 - 1) * 8
        observation = torch.stack((angle.cos(), angle.sin(), speed), -1)
        latent, _, factor = model.linearise(observation, torch.rand(2000, 1) * 4 - 2)
        y = (factor[..., 0, :] * latent).sum(-1)
        assert y.min() > 0.3


def test_sequences_are_linearised_as_single_steps_are():
    torch.manual_seed(0)
    model = KoopmanModel(3, 1, ModelConfig(2))
    observations, actions = torch.randn(2, 6, 3), torch.randn(2, 6, 1)
    latents, matrices, factors = model.encoder_and_factors(observations, actions, 4)
    latent, matrix, factor = model.linearise(observations, actions)
    torch.testing.assert_close(latents, latent)
    torch.testing.assert_close(matrices, matrix[:, :4])
    torch.testing.assert_close(factors, factor[:, :4])


def test_without_the_sign_initialisation_the_root_cost_starts_with_both_signs():
    signs = []
    for seed in range(5):
        torch.manual_seed(seed)
        model = KoopmanModel(3, 1, ModelConfig(sign_initialisation=False))
        latent, _, factor = model.linearise(torch.randn(500, 3), torch.randn(500, 1))
        y = (factor[..., 0, :] * latent).sum(-1)
        signs += [bool(y.min() > 0.3), bool(y.abs().max() > 1.0)]
    assert not any(signs)

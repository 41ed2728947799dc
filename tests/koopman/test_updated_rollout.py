"""Predictions with B and C of every predicted step: one by hand, many against a loop, and the NumPy model."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.koopman import KoopmanModel, ModelConfig, chunk_losses, export_model
from deepkoco.koopman.exported import NoDecoderError
from deepkoco.koopman.files.model_folder import read_model_folder, write_model_folder
from deepkoco.koopman.losses import ChunkBatch
from deepkoco.koopman.model.rollout import frozen_rollout, updated_rollout


def bent_model() -> KoopmanModel:
    """N = M = P = 1: s = (relu(o + a), a), Lambda = 1, C = (s_1, 0), phi^-1(s) = s_1 - s_2, R = 0.5.

    B = (1, 1) where o + a > 0 and (0, 1) elsewhere. Where s_1 > 0 the decoder is the inverse of the encoder.
    """
    model = KoopmanModel(1, 1, ModelConfig(1, 0.05, (2,), (2,), action_weight=0.5, decoder_hidden=(3,)))
    zero, one = 0.0, 1.0
    with torch.no_grad():
        first, last = model.encoder.network.linears
        # the action passes the ReLU with an offset of 9
        first.weight.copy_(torch.tensor([[one, one], [zero, one]]))
        first.bias.copy_(torch.tensor([zero, 9.0]))
        last.weight.copy_(torch.eye(2))
        last.bias.copy_(torch.tensor([zero, -9.0]))
        model.dynamics.omega.zero_()
        first, last = model.cost_factor.network.linears
        first.weight.copy_(torch.eye(2))
        first.bias.zero_()
        last.weight.copy_(torch.tensor([[one, zero], [zero, zero]]))
        last.bias.zero_()
        assert model.decoder is not None
        first, last = model.decoder.linears
        first.weight.copy_(torch.tensor([[one, -one], [zero, zero], [zero, zero]]))
        first.bias.copy_(torch.tensor([9.0, zero, zero]))
        last.weight.copy_(torch.tensor([[one, zero, zero]]))
        last.bias.fill_(-9.0)
    return model


def test_one_window_by_hand():
    # Actions 0, 1, -4, -3; increments 1, -5, 1; o_0 = 2.
    # s_0 = (2, 0), B_0 = (1, 1); s_1 = (3, 1): pseudo-observation 2, o + a = 3 > 0, B_1 = (1, 1);
    # s_2 = (3 - 5, 1 - 5) = (-2, -4): pseudo-observation 2, o + a = -2, B_2 = (0, 1); s_3 = (-2, -3).
    # C_1 = (3, 0), C_2 = C_3 = (relu(-2), 0) = 0.
    model = bent_model()
    actions = torch.tensor([[[0.0], [1.0], [-4.0], [-3.0]]])
    start, matrix, factor = model.linearise(torch.tensor([[2.0]]), actions[:, 0])
    ours = updated_rollout(model, start, matrix, factor, actions)
    torch.testing.assert_close(ours.latents, torch.tensor([[[3.0, 1.0], [-2.0, -4.0], [-2.0, -3.0]]]))
    torch.testing.assert_close(ours.factors[:, :, 0], torch.tensor([[[3.0, 0.0], [0.0, 0.0], [0.0, 0.0]]]))
    # Encoded again: (relu(2 + 1), 1), (relu(2 - 4), -4), (relu(1 - 3), -3), off by 0, (2, 0), (2, 0).
    assert ours.inverse is not None
    torch.testing.assert_close(ours.inverse, torch.tensor([(0 + 4 + 4) / 6]))
    frozen = frozen_rollout(model, start, matrix, factor, actions)
    assert frozen.inverse is None
    torch.testing.assert_close(frozen.latents, torch.tensor([[[3.0, 1.0], [-2.0, -4.0], [-1.0, -3.0]]]))


def test_losses_of_an_updated_window_by_hand():
    # As above with T = 2. Encoded: o = 2, 2, 5 gives (2, 0), (3, 1), (1, -4); rolled (3, 1), (-2, -4).
    # linear = (0 + 0 + 9 + 0) / 4 = 2.25
    # costs: c0 = (2 * 2)^2 = 16 against 15; c1 = (3 * 3)^2 + 0.5 = 81.5 against 80; c2 = 0 + 0.5 * 16 = 8 against 9
    # reconstruction = 1, prediction = (1.5^2 + 1) / 2 = 1.625; inverse = (0 + 2^2) / 4 = 1
    batch = ChunkBatch(
        torch.tensor([[[2.0], [2.0], [5.0]]]),
        torch.tensor([[[0.0], [1.0], [-4.0]]]),
        torch.tensor([[15.0, 80.0, 9.0]]),
        torch.ones(1, 1),
    )
    losses = chunk_losses(bent_model(), batch, 2, 10.0, updated_rollout)
    assert losses.linear.item() == pytest.approx(2.25)
    assert losses.cost_reconstruction.item() == pytest.approx(1.0)
    assert losses.cost_prediction.item() == pytest.approx(1.625)
    assert losses.inverse.item() == pytest.approx(1.0)
    assert losses.total.item() == pytest.approx(2.25 + 26.25 + 1.0)


def random_model(seed: int, rank: int = 1) -> KoopmanModel:
    torch.manual_seed(seed)
    config = ModelConfig(2, 0.05, (6, 5), (4,), cost_rank=rank, decoder_hidden=(7, 6))
    return KoopmanModel(3, 2, config).double()


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**20), rank=st.integers(1, 3), steps=st.integers(1, 4))
def test_updated_predictions_equal_the_recursion_with_automatic_differentiation(seed, rank, steps):
    model = random_model(seed, rank)
    o, a = torch.randn(3, dtype=torch.float64), torch.randn(steps + 1, 2, dtype=torch.float64)
    start, matrix, factor = model.linearise(o[None], a[None, 0])
    ours = updated_rollout(model, start, matrix, factor, a[None])
    s = model.encoder(o, a[0])
    assert model.decoder is not None
    for k in range(steps):
        o = model.decoder(s) if k else o
        b = torch.func.jacrev(model.encoder, argnums=1)(o, a[k])
        s = model.dynamics.matrix() @ s + b @ (a[k + 1] - a[k])
        torch.testing.assert_close(ours.latents[0, k], s)
        torch.testing.assert_close(ours.factors[0, k], model.cost_factor(s))


def test_updated_rollouts_train_the_decoder_and_frozen_ones_do_not():
    model = random_model(0)
    batch = ChunkBatch(
        *(torch.randn(2, 6, *n, dtype=torch.float64) for n in ((3,), (2,), ())),
        torch.ones(2, 2, dtype=torch.float64),
    )
    assert model.decoder is not None
    weight = model.decoder.linears[0].weight
    for rollout, trained in ((updated_rollout, True), (frozen_rollout, False)):
        model.zero_grad()
        chunk_losses(model, batch, 4, 10.0, rollout).total.backward()
        assert (weight.grad is not None and bool(weight.grad.any())) == trained


def test_the_exported_model_gives_the_same_b_and_c_along_a_plan(tmp_path):
    model = random_model(5, rank=2)
    latents, actions = torch.randn(4, 4, dtype=torch.float64), torch.randn(4, 2, dtype=torch.float64)
    write_model_folder(export_model(model), tmp_path / "m", {})
    loaded, _ = read_model_folder(tmp_path / "m")
    columns, factors = loaded.linearise_along(latents.numpy(), actions.numpy())
    expected = model.linearise_latent(latents, actions)[1].detach().numpy()
    np.testing.assert_allclose(columns.swapaxes(1, 2), expected, atol=1e-12)
    np.testing.assert_allclose(factors, model.factor(latents).detach().numpy(), atol=1e-12)
    assert loaded.decode(latents.numpy()).shape == (4, 3)


def test_a_model_without_a_decoder_says_so():
    model = KoopmanModel(3, 1, ModelConfig(2, 0.05, (4,), (4,)))
    with pytest.raises(NoDecoderError, match="decoder_hidden"):
        export_model(model).decode(np.zeros(4))
    with pytest.raises(NoDecoderError, match="decoder_hidden"):
        model.linearise_latent(torch.zeros(4), torch.zeros(1))

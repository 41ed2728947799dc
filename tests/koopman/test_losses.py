"""Training losses: one window worked out by hand, many against loops and automatic differentiation."""

import pytest
import torch

from deepkoco.koopman.losses import ChunkBatch, OtherActions, chunk_losses
from deepkoco.koopman.model.model import KoopmanModel, ModelConfig


def identity_model() -> KoopmanModel:
    """s = (o, a), Lambda = 1, B = (0, 1), C = (1, 0), R = 0.5."""
    model = KoopmanModel(1, 1, ModelConfig(1, 0.05, (), (), action_weight=0.5))
    with torch.no_grad():
        model.encoder.network.layers[0].weight.copy_(torch.eye(2))
        model.encoder.network.layers[0].bias.zero_()
        model.dynamics.omega.zero_()
        model.cost_factor.network.layers[0].weight.zero_()
        model.cost_factor.network.layers[0].bias.copy_(torch.tensor([1.0, 0.0]))
    return model


def test_one_window_by_hand():
    # Rolled: s_1 = (1, 1), s_2 = (1, 3). Encoded: (2, 1), (4, 3).
    # linear = (1 + 0 + 9 + 0) / 4 = 2.5
    # costs: c0 = 1^2 + 0 against 1; c1 = 1 + 0.5 against 2; c2 = 1 + 4.5 against 3
    # reconstruction = 0; prediction = (0.25 + 6.25) / 2 = 3.25; total = 2.5 + 10 * 3.25
    batch = ChunkBatch(
        observations=torch.tensor([[[1.0], [2.0], [4.0]]]),
        actions=torch.tensor([[[0.0], [1.0], [3.0]]]),
        costs=torch.tensor([[1.0, 2.0, 3.0]]),
        window_weights=torch.ones(1, 1),
    )
    losses = chunk_losses(identity_model(), batch, horizon=2, cost_weight=10.0)
    assert losses.linear.item() == pytest.approx(2.5)
    assert losses.cost_reconstruction.item() == pytest.approx(0.0)
    assert losses.cost_prediction.item() == pytest.approx(3.25)
    assert losses.total.item() == pytest.approx(35.0)
    # all encoded latents: 1, 0, 2, 1, 4, 3 -> squares sum 31 over 6
    assert losses.latent_scale.item() == pytest.approx((31 / 6) ** 0.5)


def test_other_actions_by_hand():
    # As above, but had the last action before s_1 been 2 and that before s_2 -1: s_1' = (1, 2), s_2' = (1, -1), costs
    # 1 + 0.5 * 4 = 3 against 4 and 1 + 0.5 = 1.5 against 3.5: (1 + 4) / 2 = 2.5; total = 35 + 10 * 0.2 * 2.5
    batch = ChunkBatch(
        observations=torch.tensor([[[1.0], [2.0], [4.0]]]),
        actions=torch.tensor([[[0.0], [1.0], [3.0]]]),
        costs=torch.tensor([[1.0, 2.0, 3.0]]),
        window_weights=torch.ones(1, 1),
    )
    others = OtherActions(torch.tensor([[[9.0], [2.0], [-1.0]]]), torch.tensor([[7.0, 4.0, 3.5]]), 0.2)
    losses = chunk_losses(identity_model(), batch, horizon=2, cost_weight=10.0, others=others)
    assert losses.total.item() == pytest.approx(40.0)
    assert losses.cost_prediction.item() == pytest.approx(3.25)


def random_batch(weights: torch.Tensor) -> ChunkBatch:
    chunks, windows = weights.shape
    length = windows + 4
    generator = torch.Generator().manual_seed(3)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    return ChunkBatch(
        draw(chunks, length, 3), draw(chunks, length, 2), draw(chunks, length) ** 2, weights.double()
    )


def looped_total(model: KoopmanModel, batch: ChunkBatch, horizon: int, cost_weight: float) -> torch.Tensor:
    """The published formulas window by window, with B from automatic differentiation."""
    totals = []
    for g, i in batch.window_weights.nonzero().tolist():
        o, a, c = batch.observations[g, i:], batch.actions[g, i:], batch.costs[g, i:]
        s = model.encoder(o[0], a[0])
        b = torch.func.jacrev(model.encoder, argnums=1)(o[0], a[0])
        row = model.cost_factor(s)

        def cost(latent, action, row=row):
            return (row @ latent) ** 2 + model.config.action_weight * action @ action

        total = cost_weight * (c[0] - cost(s, a[0])) ** 2
        for k in range(1, horizon + 1):
            s = model.dynamics.matrix() @ s + b @ (a[k] - a[k - 1])
            linear = (model.encoder(o[k], a[k]) - s).square().mean()
            total = total + (linear + cost_weight * (c[k] - cost(s, a[k])) ** 2) / horizon
        totals.append(total)
    return torch.stack(totals).mean()


def test_losses_and_gradients_equal_the_window_by_window_formulas():
    torch.manual_seed(0)
    model = KoopmanModel(3, 2, ModelConfig(2, 0.05, (6, 5), (4, 4))).double()
    batch = random_batch(torch.tensor([[1, 1, 0], [0, 1, 1]]))
    parameters = list(model.parameters())
    ours = chunk_losses(model, batch, 4, 10.0).total
    theirs = looped_total(model, batch, 4, 10.0)
    torch.testing.assert_close(ours, theirs)
    for one, other in zip(
        torch.autograd.grad(ours, parameters), torch.autograd.grad(theirs, parameters), strict=True
    ):
        torch.testing.assert_close(one, other)


def test_windows_of_weight_zero_do_not_count():
    torch.manual_seed(0)
    model = KoopmanModel(3, 2, ModelConfig(2, 0.05, (6,), (4,))).double()
    batch = random_batch(torch.tensor([[1, 1, 0]]))
    before = chunk_losses(model, batch, 4, 10.0).total
    batch.observations[0, -1] += 100.0  # only the third window reaches the last step
    assert chunk_losses(model, batch, 4, 10.0).total == before


@pytest.mark.parametrize("rank", [2, 3])
def test_the_cost_of_a_factor_with_more_rows_is_the_sum_of_their_squares(rank):
    # Rows (1, 0), (0, 1), (1, 1): c = s_1^2 + s_2^2 (+ (s_1 + s_2)^2) + 0.5 a^2.
    # s_0 = (1, 0): 1 (+ 1). Rolled s_1 = (1, 1): 2 (+ 4) + 0.5. Measured 3 and 4.
    model = KoopmanModel(1, 1, ModelConfig(1, 0.05, (), (), cost_rank=rank, action_weight=0.5))
    model.encoder.load_state_dict(identity_model().encoder.state_dict())
    with torch.no_grad():
        model.dynamics.omega.zero_()
        model.cost_factor.network.linears[0].weight.zero_()
        rows = torch.tensor([1.0, 0.0, 0.0, 1.0, 1.0, 1.0])
        model.cost_factor.network.linears[0].bias.copy_(rows[: 2 * rank])
    batch = ChunkBatch(
        torch.tensor([[[1.0], [5.0]]]),
        torch.tensor([[[0.0], [1.0]]]),
        torch.tensor([[3.0, 4.0]]),
        torch.ones(1, 1),
    )
    losses = chunk_losses(model, batch, horizon=1, cost_weight=1.0)
    first, second = {2: (1.0, 2.5), 3: (2.0, 6.5)}[rank]
    assert losses.cost_reconstruction.item() == pytest.approx((3 - first) ** 2)
    assert losses.cost_prediction.item() == pytest.approx((4 - second) ** 2)


def gradients(stopped: tuple[str, ...]) -> dict[str, torch.Tensor]:
    """Gradients of the losses of one window, in the model with s = W (o, a), C = V s + (1, 0) and Lambda = 1."""
    model = KoopmanModel(1, 1, ModelConfig(1, 0.05, (), (), action_weight=0.0, stop_gradients=stopped))
    model.load_state_dict(identity_model().state_dict())
    with torch.no_grad():
        model.cost_factor.network.linears[0].weight.copy_(torch.tensor([[0.5, 0.0], [0.0, 0.0]]))
    batch = ChunkBatch(
        torch.tensor([[[1.0], [1.0]]]),
        torch.tensor([[[0.0], [2.0]]]),
        torch.tensor([[4.0, 9.0]]),
        torch.ones(1, 1),
    )
    losses = chunk_losses(model, batch, horizon=1, cost_weight=1.0)
    losses.total.backward()
    return {name: p.grad for name, p in model.named_parameters() if p.grad is not None}


def test_stopped_gradients_by_hand():
    # s_0 = (w11, w21) = (1, 0); B = (w12, w22) = (0, 1); s_1 = s_0 + 2 B = (1, 2); C = (1 + 0.5 w11, 0) = (1.5, 0).
    # encoded s_1 = (w11 + 2 w12, w21 + 2 w22) equals the rolled one identically, so only the costs pull:
    # L = (4 - (C_1 w11)^2)^2 + (9 - (C_1 (w11 + 2 w12))^2)^2 with C_1 w11 = 1.5, errors 1.75 and 6.75
    # dL/dw12 = -2 * 6.75 * 2 * 1.5 * 1.5 * 2 = -121.5, all of it through B
    # dL/dw11 = -2 (1.75 + 6.75) * 2 * 1.5 * (C_1 + 0.5 w11) = -51 * 2.0; without the path into C: -51 * 1.5
    # The linear loss pulls where a path is cut: none at zero error.
    name = "encoder.network.layers.0.weight"
    free, no_b, no_c = gradients(())[name], gradients(("B",))[name], gradients(("C",))[name]
    assert (free[0, 0].item(), free[0, 1].item()) == pytest.approx((-102.0, -121.5))
    assert (no_b[0, 0].item(), no_b[0, 1].item()) == pytest.approx((-102.0, 0.0))
    assert (no_c[0, 0].item(), no_c[0, 1].item()) == pytest.approx((-76.5, -121.5))
    # psi itself is trained all the same: dL/dV11 = -51 * s_1 * w11 = -51
    assert gradients(("C",))["cost_factor.network.layers.0.weight"][0, 0].item() == pytest.approx(-51.0)


def test_errors_relative_to_the_cost_by_hand():
    # As in the sum of squares above with two rows: errors 3 - 1 = 2 at cost 3 and 4 - 2.5 = 1.5 at cost 4. With
    # e = 0.5 and m = 6 they weigh (3 + 6) / (3 + 3) = 1.5 and 9 / (3 + 4): at the mean cost the weight is 1.
    model = KoopmanModel(1, 1, ModelConfig(1, 0.05, (), (), cost_rank=2, action_weight=0.5))
    model.encoder.load_state_dict(identity_model().encoder.state_dict())
    with torch.no_grad():
        model.dynamics.omega.zero_()
        model.cost_factor.network.linears[0].weight.zero_()
        model.cost_factor.network.linears[0].bias.copy_(torch.tensor([1.0, 0.0, 0.0, 1.0]))
    batch = ChunkBatch(
        torch.tensor([[[1.0], [1.0]]]),
        torch.tensor([[[0.0], [1.0]]]),
        torch.tensor([[3.0, 4.0]]),
        torch.ones(1, 1),
    )
    losses = chunk_losses(model, batch, horizon=1, cost_weight=1.0, relative_above=0.5)
    assert losses.cost_reconstruction.item() == pytest.approx(4.0)  # logged as it is
    assert losses.cost_prediction.item() == pytest.approx(2.25)
    weighed = losses.total.item() - losses.linear.item()
    assert weighed == pytest.approx(4.0 * 1.5 + 2.25 * 9.0 / 7.0)

"""Latent dynamics: one case by hand, the rest against the plain recursion."""

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.koopman.jordan import JordanDynamics


def random_dynamics(pairs: int, seed: int) -> JordanDynamics:
    dynamics = JordanDynamics(pairs, 0.05).double()
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        dynamics.mu.copy_(torch.randn(pairs, generator=generator))
        dynamics.omega.copy_(5 * torch.randn(pairs, generator=generator))
    return dynamics


def test_starts_undamped_with_frequencies_from_zero_to_two_pi():
    dynamics = JordanDynamics(3, 0.05)
    assert dynamics.mu.tolist() == [0.0, 0.0, 0.0]
    torch.testing.assert_close(dynamics.omega, torch.tensor([0.0, math.pi, 2 * math.pi]))


def test_one_step_of_a_growing_quarter_turn():
    # dt = 0.5 s, mu = 2 ln 2 /s: growth by 2; omega = pi rad/s: a quarter turn.
    # (1, 0) -> (0, 2), (0, 1) -> (-2, 0).
    dynamics = JordanDynamics(1, 0.5).double()
    with torch.no_grad():
        dynamics.mu[:] = 2 * math.log(2)
        dynamics.omega[:] = math.pi
    expected = torch.tensor([[0.0, -2.0], [2.0, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(dynamics.matrix(), expected)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**20), pairs=st.integers(1, 4), actions=st.integers(1, 3), steps=st.integers(1, 8)
)
def test_rollout_equals_the_recursion(seed, pairs, actions, steps):
    dynamics = random_dynamics(pairs, seed)
    generator = torch.Generator().manual_seed(seed + 1)
    latent = torch.randn(2, 2 * pairs, generator=generator, dtype=torch.float64)
    matrix = torch.randn(2, 2 * pairs, actions, generator=generator, dtype=torch.float64)
    increments = torch.randn(2, steps, actions, generator=generator, dtype=torch.float64)
    s, expected = latent, []
    for k in range(steps):
        s = s @ dynamics.matrix().T + (matrix @ increments[:, k].unsqueeze(-1)).squeeze(-1)
        expected.append(s)
    torch.testing.assert_close(dynamics.rollout(latent, matrix, increments), torch.stack(expected, 1))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**20), pairs=st.integers(1, 5))
def test_moduli_are_exponentials_of_the_growth_rates(seed, pairs):
    dynamics = random_dynamics(pairs, seed)
    moduli = torch.linalg.eigvals(dynamics.matrix()).abs().sort().values
    expected = torch.exp(dynamics.mu * 0.05).repeat_interleave(2).sort().values
    torch.testing.assert_close(moduli, expected)

"""Ornstein-Uhlenbeck noise."""

import pytest
import torch

from deepkoco.agent.exploration import OrnsteinUhlenbeck, action_units, annealed_variance


def test_each_step_keeps_a_share_and_adds_scaled_normal_noise():
    noise = OrnsteinUhlenbeck(3, 2, 0.85, 0.81, torch.Generator().manual_seed(5))
    draws = torch.Generator().manual_seed(5)
    expected = torch.zeros(3, 2, dtype=torch.float64)
    for _ in range(3):
        innovation = torch.randn(3, 2, generator=draws, dtype=torch.float64)
        expected = 0.85 * expected + 0.9 * innovation
        torch.testing.assert_close(noise.step(), expected)


def test_variance_is_that_of_the_innovation():
    # The stationary variance is 0.85 / (1 - 0.85^2) = 3.06.
    noise = OrnsteinUhlenbeck(20000, 1, 0.85, 0.85, torch.Generator().manual_seed(0))
    for _ in range(60):
        last = noise.step()
    assert last.var().item() == pytest.approx(0.85 / (1 - 0.85**2), rel=0.05)


def test_reset_returns_to_zero():
    generator = torch.Generator().manual_seed(0)
    noise, fresh = (OrnsteinUhlenbeck(2, 1, 0.85, 1.0, generator) for _ in range(2))
    noise.step()
    noise.reset()
    state = generator.get_state()
    again = noise.step().clone()
    generator.set_state(state)
    torch.testing.assert_close(again, fresh.step(), rtol=0.0, atol=0.0)


def test_without_variance_nothing_moves():
    noise = OrnsteinUhlenbeck(2, 1, 0.85, 0.0, torch.Generator().manual_seed(0))
    assert noise.step().abs().max() == 0.0


@pytest.mark.parametrize(("episodes", "expected"), [(0, 0.85), (200, 0.425), (400, 0.0), (900, 0.0)])
def test_variance_falls_linearly_to_zero(episodes, expected):
    assert annealed_variance(0.85, episodes, 400) == pytest.approx(expected)


def test_noise_is_in_quarters_of_the_range_and_calmer_from_environment_to_environment():
    low, high = torch.tensor([-10.0, -2.0]).double(), torch.tensor([10.0, 2.0]).double()
    noises = [
        OrnsteinUhlenbeck(
            3, 2, 0.85, 0.81, torch.Generator().manual_seed(5), action_units(name, low, high), floor
        )
        for name, floor in (("action", 1.0), ("range", 0.01))
    ]
    plain, scaled = (noise.step() for noise in noises)
    # Quarters of the ranges are 5 and 1; levels 1, 0.1 and 0.01.
    factors = torch.tensor([[5.0, 1.0], [0.5, 0.1], [0.05, 0.01]]).double()
    torch.testing.assert_close(scaled, plain * factors)

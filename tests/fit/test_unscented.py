"""Unscented filter against filterpy and the exact Kalman filter, and its numerical limits."""

import math

import numpy as np
import pytest
import torch
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.state.unscented import Belief, FilterError, SigmaPoints, predict, update

F64 = torch.float64
H = 0.05


def swing(x: torch.Tensor) -> torch.Tensor:
    """One step of a pendulum by the symplectic Euler rule."""
    speed = x[..., 1] - H * 9.81 * torch.sin(x[..., 0])
    return torch.stack([x[..., 0] + H * speed, speed], -1)


def seen(x: torch.Tensor) -> torch.Tensor:
    return torch.stack([torch.sin(x[..., 0]), x[..., 1]], -1)


def test_unscented_filter_matches_filterpy():
    q, r = np.array([[2e-4, 1e-4], [1e-4, 3e-3]]), np.array([0.02, 0.1])
    rule = SigmaPoints(alpha=0.9, beta=2.0, kappa=1.0)
    theirs = UnscentedKalmanFilter(
        2, 2, H,
        hx=lambda x: seen(torch.tensor(x)).numpy(),
        fx=lambda x, dt: swing(torch.tensor(x)).numpy(),
        points=MerweScaledSigmaPoints(2, 0.9, 2.0, 1.0),
    )  # fmt: skip
    theirs.x, theirs.P, theirs.Q, theirs.R = np.array([1.0, 0.0]), np.diag([0.1, 0.5]), q, np.diag(r**2)
    belief = Belief(
        torch.tensor([[1.0, 0.0]], dtype=F64), torch.diag(torch.tensor([0.1, 0.5], dtype=F64)).sqrt()[None]
    )
    root = torch.linalg.cholesky(torch.tensor(q))
    rng = np.random.default_rng(0)
    state = torch.tensor([1.3, 0.2], dtype=F64)
    for _ in range(60):
        state = swing(state)
        measured = seen(state).numpy() + r * rng.standard_normal(2)
        theirs.predict()
        theirs.update(measured)
        belief = predict(belief, swing, root, rule)
        belief, likelihood = update(belief, seen, torch.tensor(measured)[None], torch.tensor(r), rule)
        assert belief.mean[0].numpy() == pytest.approx(theirs.x, abs=1e-9)
        assert belief.covariance[0].numpy() == pytest.approx(theirs.P, abs=1e-10)
        assert float(likelihood) == pytest.approx(theirs.log_likelihood, abs=1e-6)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_unscented_filter_is_exact_for_linear_systems(seed):
    rng = np.random.default_rng(seed)
    size, channels = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    a, c = rng.standard_normal((size, size)), rng.standard_normal((channels, size))
    q, sd = rng.standard_normal((size, size)), rng.uniform(0.1, 1.0, channels)
    mean, root = rng.standard_normal(size), np.tril(rng.standard_normal((size, size)))
    y = rng.standard_normal(channels)
    predicted = a @ mean
    covariance = a @ root @ root.T @ a.T + q @ q.T
    gain = covariance @ c.T @ np.linalg.inv(c @ covariance @ c.T + np.diag(sd**2))
    expected = predicted + gain @ (y - c @ predicted)
    rest = np.eye(size) - gain @ c
    covariance = rest @ covariance @ rest.T + gain @ np.diag(sd**2) @ gain.T
    belief = Belief(torch.tensor(mean)[None], torch.tensor(root)[None])
    lower = torch.linalg.cholesky(torch.tensor(q @ q.T + 1e-15 * np.eye(size)))
    belief = predict(belief, lambda x: x @ torch.tensor(a).T, lower, SigmaPoints())
    belief, _ = update(
        belief, lambda x: x @ torch.tensor(c).T, torch.tensor(y)[None], torch.tensor(sd), SigmaPoints()
    )
    assert belief.mean[0].numpy() == pytest.approx(expected, abs=1e-8)
    assert belief.covariance[0].numpy() == pytest.approx(covariance, abs=1e-8)


def test_update_with_a_missing_channel_equals_update_without_it():
    rule, sd = SigmaPoints(), torch.tensor([0.1, 0.2], dtype=F64)
    belief = Belief(
        torch.tensor([[0.4, -0.3]], dtype=F64), torch.tensor([[[0.5, 0.0], [0.2, 0.4]]], dtype=F64)
    )
    half, likelihood = update(belief, seen, torch.tensor([[0.5, math.nan]], dtype=F64), sd, rule)
    alone, other = update(belief, lambda x: seen(x)[..., :1], torch.tensor([[0.5]], dtype=F64), sd[:1], rule)
    assert torch.allclose(half.mean, alone.mean)
    assert torch.allclose(half.covariance, alone.covariance)
    assert float(likelihood) == pytest.approx(float(other))
    none, _ = update(belief, seen, torch.full((1, 2), math.nan, dtype=F64), sd, rule)
    assert torch.allclose(none.mean, belief.mean)
    assert torch.allclose(none.covariance, belief.covariance)


def test_update_of_a_batch_equals_single_environments():
    generator = torch.Generator().manual_seed(0)
    mean = torch.randn(5, 2, generator=generator, dtype=F64)
    root = torch.randn(5, 2, 2, generator=generator, dtype=F64).tril()
    y = torch.randn(5, 2, generator=generator, dtype=F64)
    noise, sd = 0.1 * torch.eye(2, dtype=F64), torch.tensor([0.1, 0.2], dtype=F64)

    def both(belief, measured):
        return update(predict(belief, swing, noise, SigmaPoints()), seen, measured, sd, SigmaPoints())[0]

    together = both(Belief(mean, root), y)
    for b in range(5):
        alone = both(Belief(mean[b : b + 1], root[b : b + 1]), y[b : b + 1])
        assert torch.allclose(together.mean[b], alone.mean[0])
        assert torch.allclose(together.covariance[b], alone.covariance[0])


def test_update_wraps_the_innovation_of_an_angle():
    belief = Belief(torch.tensor([[math.pi - 0.01, 0.0]], dtype=F64), 0.1 * torch.eye(2, dtype=F64)[None])
    angle = torch.tensor([True])
    measured = torch.tensor([[-math.pi + 0.01]], dtype=F64)
    found, _ = update(
        belief, lambda x: x[..., :1], measured, torch.tensor([0.1], dtype=F64), SigmaPoints(), angle
    )
    # Prior and sensor have equal variance and differ by 0.02 rad, so the mean is half way.
    assert float(found.mean[0, 0]) == pytest.approx(math.pi, abs=1e-9)


def test_update_keeps_covariance_positive_with_a_nearly_perfect_sensor():
    belief = Belief(torch.zeros(1, 2, dtype=F64), torch.diag(torch.tensor([1e4, 1e4], dtype=F64))[None])
    for _ in range(200):
        belief = predict(belief, swing, 1e-9 * torch.eye(2, dtype=F64), SigmaPoints())
        zero, sd = torch.zeros(1, 1, dtype=F64), torch.tensor([1e-9], dtype=F64)
        belief, _ = update(belief, lambda x: x[..., :1], zero, sd, SigmaPoints())
    assert bool(torch.isfinite(belief.mean).all())
    assert float(torch.linalg.eigvalsh(belief.covariance)[0, 0]) >= 0.0


def test_sigma_points_refuse_negative_covariance_weights():
    with pytest.raises(FilterError, match="must not be negative"):
        SigmaPoints(alpha=1e-3, beta=2.0).weights(3)

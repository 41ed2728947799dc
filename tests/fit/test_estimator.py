"""DelayedEstimator against an exact Kalman filter that gets the measurements in the order of their times."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from deepkoco.fit.state.estimator import DelayedEstimator, Memory
from deepkoco.fit.state.unscented import Belief, FilterError

F64 = torch.float64
DAMPING, SENSING, ACTUATION = 0.5, 0.03, 0.02
# x' = v, v' = u - d v, with noise on v; only x is measured.
A = np.array([[0.0, 1.0], [0.0, -DAMPING]])
B = np.array([0.0, 1.0])
DENSITY = np.diag([0.0, 0.04])
SD = 0.05


def derivative(state, command):
    return torch.stack([state[..., 1], command[..., 0] - DAMPING * state[..., 1]], -1)


def make(kept: int = 8, step: float = 0.0005) -> DelayedEstimator:
    return DelayedEstimator(
        derivative,
        lambda x: x[..., :1],
        torch.tensor(DENSITY),
        torch.tensor([SD], dtype=F64),
        kept=kept,
        longest_step=step,
    )


def begin(estimator: DelayedEstimator, batch: int = 1) -> Memory:
    belief = Belief(torch.zeros(batch, 2, dtype=F64), torch.eye(2, dtype=F64).expand(batch, 2, 2))
    return estimator.start(belief, torch.zeros(batch, dtype=F64), torch.zeros(batch, 1, dtype=F64))


def exact(measurements, commands, stop):
    """Kalman filter over times in ascending order, with matrix exponentials between them."""

    def carry(mean, covariance, t0, t1):
        edges = [t0, *(t for t, _ in commands if t0 < t < t1), t1]
        for left, right in pairwise(edges):
            held = [u for t, u in commands if t <= left]
            # Van Loan: one exponential gives the transition and the integral of the noise.
            h = right - left
            block = np.zeros((4, 4))
            block[:2, :2], block[:2, 2:], block[2:, 2:] = -A, DENSITY, A.T
            big = expm(block * h)
            phi = big[2:, 2:].T
            noise = phi @ big[:2, 2:]
            driven = np.zeros((3, 3))
            driven[:2, :2], driven[:2, 2] = A, B
            drive = expm(driven * h)[:2, 2] * (held[-1] if held else 0.0)
            mean, covariance = phi @ mean + drive, phi @ covariance @ phi.T + noise
        return mean, covariance

    mean, covariance, at = np.zeros(2), np.eye(2), 0.0
    for t, y in sorted(measurements):
        mean, covariance = carry(mean, covariance, at, t)
        gain = covariance[:, 0] / (covariance[0, 0] + SD**2)
        mean = mean + gain * (y - mean[0])
        covariance = covariance - np.outer(gain, covariance[0])
        at = t
    return carry(mean, covariance, at, stop)


def scenario():
    rng = np.random.default_rng(1)
    taken = np.sort(rng.uniform(0.01, 0.4, 7))  # irregular
    sent = [(0.0, 1.0), (0.11, -2.0), (0.27, 0.5), (0.41, 3.0)]
    return [(float(t), float(rng.standard_normal())) for t in taken], sent


def play(estimator, measurements, sent, delay=SENSING):
    memory = begin(estimator)
    for t, u in sent:
        memory = estimator.send(memory, torch.tensor([t]), torch.tensor([[u]], dtype=F64), ACTUATION)
    for t, y in measurements:
        memory = estimator.receive(
            memory, torch.tensor([t + delay], dtype=F64), torch.tensor([[y]], dtype=F64), delay
        )
    return memory


def test_estimator_matches_exact_kalman_filter_for_irregular_late_measurements():
    measurements, sent = scenario()
    estimator = make()
    belief = estimator.estimate(
        play(estimator, measurements, sent), torch.tensor([0.45], dtype=F64), ACTUATION
    )
    mean, covariance = exact(measurements, [(t + ACTUATION, u) for t, u in sent], 0.45 + ACTUATION)
    assert belief.mean[0].numpy() == pytest.approx(mean, abs=1e-6)
    assert belief.covariance[0].numpy() == pytest.approx(covariance, rel=2e-3, abs=1e-7)


@pytest.mark.parametrize("order", [(1, 0, 2, 3, 4, 5, 6), (6, 5, 4, 3, 2, 1, 0), (0, 3, 2, 1, 6, 4, 5)])
def test_estimator_is_independent_of_the_order_of_arrival(order):
    measurements, sent = scenario()
    estimator = make(step=0.01)
    right = play(estimator, measurements, sent)
    mixed = play(estimator, [measurements[i] for i in order], sent)
    now = torch.tensor([0.45], dtype=F64)
    assert torch.allclose(
        estimator.estimate(right, now).mean, estimator.estimate(mixed, now).mean, atol=1e-12
    )
    assert torch.allclose(right.root @ right.root.mT, mixed.root @ mixed.root.mT, atol=1e-12)


def test_estimator_counts_and_ignores_measurements_older_than_its_memory():
    measurements, sent = scenario()
    estimator = make(kept=2, step=0.01)
    memory = play(estimator, measurements[1:], sent)
    late = estimator.receive(
        memory, torch.tensor([measurements[0][0] + SENSING]), torch.tensor([[5.0]], dtype=F64), SENSING
    )
    assert late.dropped.tolist() == [1]
    assert torch.equal(late.mean, memory.mean)


def test_estimator_receives_at_different_times_per_environment():
    measurements, sent = scenario()
    estimator = make(step=0.01)
    alone = [play(estimator, measurements[:n], sent) for n in (3, 5)]
    memory = begin(estimator, 2)
    for t, u in sent:
        both = torch.full((2, 1), u, dtype=F64)
        memory = estimator.send(memory, torch.tensor([t, t]), both, ACTUATION)
    for i, (t, y) in enumerate(measurements[:5]):
        stamps = torch.tensor([t if i < 3 else math.nan, t], dtype=F64) + SENSING
        memory = estimator.receive(memory, stamps, torch.full((2, 1), y, dtype=F64), SENSING)
    for b in range(2):
        expected, _ = alone[b].newest()
        assert torch.allclose(memory.newest()[0].mean[b], expected.mean[0], atol=1e-12)


def test_estimator_uses_noise_of_each_time_and_measurement():
    def quiet_then_loud(t):
        size = torch.where(t < 0.1, 0.0, 1.0)
        return size[:, None, None] * torch.tensor(DENSITY)

    estimator = DelayedEstimator(
        derivative, lambda x: x[..., :1], quiet_then_loud, torch.tensor([SD], dtype=F64)
    )
    memory = begin(estimator)
    early = estimator.estimate(memory, torch.tensor([0.1], dtype=F64)).covariance
    never = DelayedEstimator(
        derivative, lambda x: x[..., :1], torch.zeros(2, 2, dtype=F64), torch.tensor([SD], dtype=F64)
    )
    assert torch.allclose(early, never.estimate(begin(never), torch.tensor([0.1], dtype=F64)).covariance)
    later = estimator.estimate(memory, torch.tensor([0.3], dtype=F64)).covariance
    quiet = never.estimate(begin(never), torch.tensor([0.3], dtype=F64)).covariance
    assert float(later[0, 1, 1]) > float(quiet[0, 1, 1]) + 0.005  # 0.2 s at 0.04 per second, damped
    y, now = torch.tensor([[1.0]], dtype=F64), torch.tensor([0.1], dtype=F64)
    sure = estimator.receive(memory, now, y, 0.0, torch.tensor([1e-6], dtype=F64)).newest()[0]
    assert float(sure.mean[0, 0]) == pytest.approx(1.0, abs=1e-6)


def test_estimator_refuses_a_negative_noise_density():
    with pytest.raises(FilterError, match="positive semidefinite"):
        DelayedEstimator(derivative, lambda x: x, -torch.eye(2, dtype=F64), torch.ones(2, dtype=F64))

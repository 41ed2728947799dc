"""Value iteration, iLQR and MPC against exhaustive search, quadratic programs and each other."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from qpsolvers import solve_qp

from deepkoco.envs.registration import ENVIRONMENTS
from deepkoco.envs.settings import EnvironmentSettings
from deepkoco.optimal import (
    ILQR,
    ModelPredictiveControl,
    PredictiveConfig,
    TrueModel,
    TrueModelError,
    ValueIteration,
    play,
    squared_curvature,
)
from deepkoco.optimal.cross_entropy import CrossEntropyConfig


def pendulum() -> TrueModel:
    return TrueModel(EnvironmentSettings(**ENVIRONMENTS["deepkoco/RodPendulum-v0"][1]))


class LinearQuadratic:
    """x' = A x + B a, c = x'x + 0.1 a'a, with limits of a."""

    angles, state_size = 1, 2

    def __init__(self, seed: int, width: int, limit: float) -> None:
        draw = np.random.default_rng(seed)
        self.a = torch.from_numpy(np.eye(2) + 0.3 * draw.normal(size=(2, 2)))
        self.b = torch.from_numpy(draw.normal(size=(2, width)))
        self.high = torch.full((width,), limit, dtype=torch.float64)
        self.low = -self.high

    def step(self, state, action):
        return state @ self.a.mT + action @ self.b.mT

    def cost(self, state, action):
        return (state**2).sum(-1) + 0.1 * (action**2).sum(-1)

    def best(self, start, horizon):
        """Optimal cost, as a quadratic program in all actions."""
        width, a, b = len(self.low), self.a.numpy(), self.b.numpy()
        powers = [np.linalg.matrix_power(a, k) for k in range(horizon + 1)]
        free = np.concatenate([p @ start for p in powers[1:]])
        forced = np.zeros((2 * horizon, width * horizon))
        for k, j in itertools.product(range(horizon), range(horizon)):
            if j <= k:
                forced[2 * k : 2 * k + 2, width * j : width * j + width] = powers[k - j] @ b
        p = 2 * (forced.T @ forced + 0.1 * np.eye(width * horizon))
        limits = np.full(width * horizon, float(self.high[0]))
        u = solve_qp(p, 2 * forced.T @ free, lb=-limits, ub=limits, solver="daqp")
        return start @ start + ((free + forced @ u) ** 2).sum() + 0.1 * u @ u


@given(st.integers(0, 10_000), st.integers(1, 2), st.sampled_from((0.2, 0.5, 50.0)))
@settings(max_examples=6, deadline=None)
def test_ilqr_finds_the_optimum_of_limited_linear_quadratic_problems(seed, width, limit):
    model = LinearQuadratic(seed, width, limit)
    start = torch.randn(2, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    plan = ILQR(model).solve(start, torch.zeros(2, 6, width, dtype=torch.float64), 12)  # pyright: ignore
    best = [model.best(x.numpy(), 6) for x in start]
    np.testing.assert_allclose(plan.cost, best, rtol=1e-5)
    assert (plan.actions.abs() <= limit).all()


def test_the_curvature_of_a_distance_leads_to_its_kink():
    points = torch.tensor([[3.0, 4.0], [0.3, -0.4]], dtype=torch.float64)
    slope, curve = squared_curvature(lambda z: torch.sqrt((z**2).sum()), points)
    torch.testing.assert_close(slope, points / points.norm(dim=1, keepdim=True), rtol=1e-4, atol=0)
    step = torch.linalg.solve(curve, -slope[..., None])[..., 0]
    torch.testing.assert_close(points + step, torch.zeros_like(points), rtol=0, atol=1e-9)


def test_two_sweeps_are_the_best_of_all_pairs_of_actions():
    model = pendulum()
    table = ValueIteration(model, 401, 401, 5).solve(sweeps=2, tolerance=0.0)
    start = torch.tensor([[0.4, 0.3], [-2.0, 1.0], [2.5, -3.0]], dtype=torch.float64)
    choices = torch.linspace(-2, 2, 5, dtype=torch.float64)
    totals = []
    for first, second in itertools.product(choices, choices):
        one, two = first.expand(3, 1), second.expand(3, 1)
        totals.append(model.cost(start, one) + model.cost(model.step(start, one), two))
    # The grid interpolates a parabola linearly: 2 pi / 401 apart, it is at most 1e-3 too high.
    np.testing.assert_allclose(table.at(start), torch.stack(totals).min(0).values, rtol=1e-3)
    with pytest.raises(TrueModelError, match="one joint"):
        ValueIteration(TrueModel(EnvironmentSettings(**ENVIRONMENTS["deepkoco/Manipulator-v0"][1])))


def test_mpc_and_value_iteration_agree_near_upright():
    model = pendulum()
    start = torch.tensor([[0.3, 0.0], [-0.3, 1.0]], dtype=torch.float64)
    iteration = ValueIteration(model, 151, 151, 9)
    table = iteration.solve(sweeps=40)
    search = CrossEntropyConfig(holds=(5,), samples=32, iterations=4, elite=6)
    controller = ModelPredictiveControl(model, PredictiveConfig(15, 5, 1, search))
    planned = play(model, start, 20, controller).total
    tabled = play(model, start, 20, iteration.controller(table)).total
    np.testing.assert_allclose(planned, tabled, rtol=0.02)
    np.testing.assert_allclose(table.at(start), tabled, rtol=0.2)

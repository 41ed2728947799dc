"""Control-limited iterative LQR for a batch of start states at once."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.func import grad, hessian, jacfwd, vmap

from deepkoco.optimal.true_model import TrueModel

CostFunction = Callable[[Tensor], Tensor]  # (S + M,) state and action -> ()
Curvature = Callable[[CostFunction, Tensor], tuple[Tensor, Tensor]]
STEP_SIZES = (1.0, 0.6, 0.3, 0.1, 0.03)
_RIDGE = (1e-8, 1e8)


def true_curvature(cost: CostFunction, points: Tensor) -> tuple[Tensor, Tensor]:
    """Gradients (n, S + M) and Hessians, cut to their positive part, at points (n, S + M)."""
    return vmap(grad(cost))(points), _positive_part(vmap(hessian(cost))(points))


def squared_curvature(cost: CostFunction, points: Tensor, floor: float = 1e-3) -> tuple[Tensor, Tensor]:
    """The same of sqrt(c^2 + floor^2), with the curvature of c^2 / (2 c): for a cost that is a distance.

    A distance has a kink at 0 and no curvature towards it; the curvature taken here bounds it from above, so
    that a Newton step leads to the kink instead of beyond.

    Source: iteratively reweighted least squares; Daubechies et al., CPAM 63 (2010).
    """
    twice = 2.0 * torch.sqrt(vmap(cost)(points) ** 2 + floor**2)[:, None]

    def square(point: Tensor) -> Tensor:
        return cost(point) ** 2

    slope = torch.nan_to_num(vmap(grad(square))(points)) / twice
    return slope, _positive_part(torch.nan_to_num(vmap(hessian(square))(points))) / twice[..., None]


def _positive_part(matrices: Tensor) -> Tensor:
    values, vectors = torch.linalg.eigh(matrices)
    return (vectors * values.clamp(min=0.0)[:, None, :]) @ vectors.mT


@dataclass(frozen=True)
class Plan:
    """Actions and where they lead.

    Attributes:
        actions: (B, H, M).
        states: (B, H + 1, S).
        cost: (B,).
    """

    actions: Tensor
    states: Tensor
    cost: Tensor

    def take(self, index: Tensor) -> Plan:
        """The plans of some rows."""
        return Plan(self.actions[index], self.states[index], self.cost[index])


class ILQR:
    """min over a_0 .. a_{H-1} of sum_k c(x_k, a_k) + c(x_H, 0), x_{k+1} = f(x_k, a_k), a_min <= a_k <= a_max.

    Each iteration solves the limited quadratic program of every step exactly, by trying all active sets, so it
    is for few actions. A step is only taken where it lowers the cost, and what is regularised is regularised for
    each start state by itself.

    Args:
        model: f, c and the limits.
        curvature: How the cost is approximated; `true_curvature` or `squared_curvature`.

    Source: Tassa, Mansard, Todorov, Control-limited differential dynamic programming, ICRA 2014, without the
        second derivatives of f.
    """

    def __init__(self, model: TrueModel, curvature: Curvature = true_curvature) -> None:
        self.model, self._curvature = model, curvature
        patterns = itertools.product((-1, 0, 1), repeat=len(model.low))
        self._patterns = torch.tensor(list(patterns))  # (3^M, M): at the lower limit, free, at the upper one

    def solve(self, start: Tensor, actions: Tensor, iterations: int) -> Plan:
        """Improve plans.

        Args:
            start: (B, S).
            actions: The first guess (B, H, M).
            iterations: Of the whole batch.
        """
        plan = self.roll_out(start, actions)
        ridge = torch.full((len(start),), 1e-4, dtype=torch.float64)
        for _ in range(iterations):
            better = self._search(plan, *self._backward(plan, ridge))
            improved = better.cost < plan.cost
            chosen = improved[:, None, None]
            plan = Plan(
                torch.where(chosen, better.actions, plan.actions),
                torch.where(chosen, better.states, plan.states),
                torch.where(improved, better.cost, plan.cost),
            )
            ridge = torch.where(improved, ridge * 0.2, ridge * 10.0).clamp(*_RIDGE)
        return plan

    def roll_out(self, start: Tensor, actions: Tensor) -> Plan:
        """Where actions (B, H, M) lead from states (B, S)."""
        states = [start]
        for k in range(actions.shape[1]):
            states.append(self.model.step(states[-1], actions[:, k]))
        return self._plan(actions, torch.stack(states, 1))

    def _plan(self, actions: Tensor, states: Tensor) -> Plan:
        last = self.model.cost(states[:, -1], torch.zeros_like(actions[:, 0]))
        return Plan(actions, states, self.model.cost(states[:, :-1], actions).sum(1) + last)

    def _backward(self, plan: Plan, ridge: Tensor) -> tuple[Tensor, Tensor]:
        """Changes (B, H, M) and gains (B, H, M, S)."""
        batch, horizon, width = plan.actions.shape
        size = self.model.state_size
        final = torch.cat([plan.states[:, -1:], torch.zeros_like(plan.actions[:, :1])], -1)
        points = torch.cat([torch.cat([plan.states[:, :-1], plan.actions], -1), final], 1)
        slopes, curves = self._curvature(
            lambda z: self.model.cost(z[:size], z[size:]), points.reshape(-1, size + width)
        )
        slopes = slopes.reshape(batch, horizon + 1, -1)
        curves = curves.reshape(batch, horizon + 1, size + width, size + width)
        steps = vmap(jacfwd(lambda z: self.model.step(z[:size], z[size:])))(
            points[:, :-1].reshape(-1, size + width)
        ).reshape(batch, horizon, size, size + width)

        slope, curve = slopes[:, -1, :size], curves[:, -1, :size, :size]
        unit = ridge[:, None, None] * torch.eye(width, dtype=torch.float64)
        changes, gains = [], []
        for k in reversed(range(horizon)):
            f = steps[:, k]
            q = slopes[:, k] + (f.mT @ slope[..., None])[..., 0]
            qq = curves[:, k] + f.mT @ curve @ f
            qu, quu, qux = q[:, size:], qq[:, size:, size:], qq[:, size:, :size]
            change, gain = self._limited(quu + unit, qu, qux, plan.actions[:, k])
            slope = (
                q[:, :size]
                + (gain.mT @ (quu @ change[..., None] + qu[..., None]) + qux.mT @ change[..., None])[..., 0]
            )
            curve = qq[:, :size, :size] + gain.mT @ quu @ gain + gain.mT @ qux + qux.mT @ gain
            curve = 0.5 * (curve + curve.mT)
            changes.append(change)
            gains.append(gain)
        return torch.stack(changes[::-1], 1), torch.stack(gains[::-1], 1)

    def _limited(self, quu: Tensor, qu: Tensor, qux: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Minimiser (B, M) of the program of one step, and the gain (B, M, S) of what is free there."""
        low, high = (self.model.low - action)[:, None], (self.model.high - action)[:, None]  # (B, 1, M)
        free = (self._patterns == 0)[None]  # (1, 3^M, M)
        fixed = torch.where(self._patterns < 0, low, high)
        fixed = torch.where(free, 0.0, fixed)
        both = free[..., :, None] & free[..., None, :]
        unit = torch.eye(quu.shape[-1], dtype=torch.float64)
        matrix = torch.where(both, quu[:, None], unit)
        pulled = qu[:, None] + (quu[:, None] @ fixed[..., None])[..., 0]
        tried = torch.linalg.solve(matrix, torch.where(free, -pulled, fixed)[..., None])[..., 0]
        slack = 1e-9
        inside = ((tried >= low - slack) & (tried <= high + slack)).all(-1)
        value = (tried * (qu[:, None] + 0.5 * (quu[:, None] @ tried[..., None])[..., 0])).sum(-1)
        best = torch.where(inside, value, torch.inf).argmin(1)
        rows = torch.arange(len(best))
        loose = torch.where(free[0][best][..., None], qux, 0.0)
        return tried[rows, best], -torch.linalg.solve(matrix[rows, best], loose)

    def _search(self, plan: Plan, changes: Tensor, gains: Tensor) -> Plan:
        """The best of some step sizes, for each start state."""
        batch, horizon, _ = plan.actions.shape
        count = len(STEP_SIZES)
        sizes = torch.tensor(STEP_SIZES, dtype=torch.float64).repeat(batch)[:, None]
        nominal, before, moves, feedback = (
            x.repeat_interleave(count, 0) for x in (plan.states, plan.actions, changes, gains)
        )
        states, actions = [nominal[:, 0]], []
        for k in range(horizon):
            correction = (feedback[:, k] @ (states[-1] - nominal[:, k])[..., None])[..., 0]
            action = before[:, k] + sizes * moves[:, k] + correction
            actions.append(torch.minimum(torch.maximum(action, self.model.low), self.model.high))
            states.append(self.model.step(states[-1], actions[-1]))
        tried = self._plan(torch.stack(actions, 1), torch.stack(states, 1))
        cost = torch.nan_to_num(tried.cost, nan=torch.inf).reshape(batch, count)
        return tried.take(torch.arange(batch) * count + cost.argmin(1))

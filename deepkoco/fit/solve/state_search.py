"""Initial states of windows at fixed parameters: each window of each set is a small problem of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.tangent import MANY_STATES, state_steps

ITERATIONS = 8  # of a search that lowers a cost


@dataclass
class StateSearch:
    """Levenberg-Marquardt of the initial states of K sets and W windows, each with a step and a damping of its own.

    Attributes:
        best: (K, W, S) states of the lowest cost.
        trial: (K, W, S) states that are simulated next.
        cost: (K, W) lowest cost.
        damping: (K, W).
        settled: (K, W) whether the states are found.
        hessian: (K, W, S, S) curvature of the cost at the best states.
        gradient: (K, W, S) its descent direction.
        slopes: (K, W, S, NM) whitened slopes of the measurements; (K, W, S, 0) before the first simulation.
    """

    best: Tensor
    trial: Tensor
    cost: Tensor
    damping: Tensor
    settled: Tensor
    hessian: Tensor
    gradient: Tensor
    slopes: Tensor

    @staticmethod
    def at(state: Tensor) -> StateSearch:
        """Begin at states (K, W, S)."""
        sets, count, size = state.shape
        return StateSearch(
            state.clone(),
            state.clone(),
            torch.full((sets, count), torch.inf, dtype=torch.float64),
            torch.full((sets, count), 1e-3, dtype=torch.float64),
            torch.zeros(sets, count, dtype=torch.bool),
            torch.eye(size, dtype=torch.float64).repeat(sets, count, 1, 1),
            torch.zeros(sets, count, size, dtype=torch.float64),
            torch.zeros(sets, count, size, 0, dtype=torch.float64),
        )

    def of(self, rows: Tensor, columns: Tensor) -> StateSearch:
        """The search of some sets and windows."""
        return StateSearch(*(getattr(self, f.name)[rows][:, columns] for f in fields(self)))

    def put(self, rows: Tensor, columns: Tensor, part: StateSearch) -> None:
        """Take over what has become of some sets and windows."""
        if self.slopes.shape[-1] != part.slopes.shape[-1]:
            self.slopes = torch.zeros(*self.gradient.shape, part.slopes.shape[-1], dtype=torch.float64)
        for f in fields(self):
            getattr(self, f.name)[rows[:, None], columns] = getattr(part, f.name)

    def judge(self, residual: Tensor, tolerance: float) -> None:
        """Take the simulated states where they lower the cost.

        Args:
            residual: (K, W, NM) whitened residuals at them.
            tolerance: Fall of the cost of a window below which its states are found.
        """
        now = (residual**2).sum(-1)
        curvature = self.slopes @ self.slopes.mT
        downhill = (self.slopes @ residual[..., None])[..., 0]
        # The cost can be finite although a lane of the finite differences diverged.
        better = torch.isfinite(now) & torch.isfinite(curvature).flatten(2).all(-1)
        better &= torch.isfinite(downhill).all(-1) & (now <= self.cost)
        # At the minimum, rounding can make the cost of a step slightly larger than before.
        close = (self.cost - now).abs() <= tolerance + 1e-4 * now
        self.hessian = torch.where(better[..., None, None], curvature, self.hessian)
        self.gradient = torch.where(better[..., None], downhill, self.gradient)
        self.best = torch.where(better[..., None], self.trial, self.best)
        self.cost = torch.where(better, now, self.cost)
        self.damping = torch.where(better, self.damping * 0.1, self.damping * 20.0).clamp(1e-9, 1e9)
        self.settled = close | (self.damping > 1e6)

    def promised(self) -> Tensor:
        """Return the costs (K, W) to which a step without damping would lead if the slopes held."""
        matrix = self.hessian + 1e-9 * torch.eye(self.best.shape[-1], dtype=torch.float64)
        step, singular = torch.linalg.solve_ex(matrix, self.gradient)
        fall = torch.where(singular == 0, (step * self.gradient).sum(-1), self.cost)
        return (self.cost - fall).clamp_min(0.0)

    def propose(self) -> None:
        """Take a damped step from the best states."""
        diagonal = torch.diagonal(self.hessian, dim1=-2, dim2=-1)
        matrix = self.hessian + torch.diag_embed(self.damping[..., None] * diagonal + 1e-9)
        step, singular = torch.linalg.solve_ex(matrix, self.gradient)
        self.trial = self.best + torch.where((singular == 0)[..., None], step, 0.0)


def search_states(
    problem: ShootingProblem,
    theta: np.ndarray,
    state: Tensor,
    nuisance: Tensor,
    iterations: int,
    tolerance: float,
    sought: Tensor | None = None,
    most: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Fit the initial states of K sets of parameters, in one batch.

    Args:
        problem: The windows.
        theta: (K, P) all parameters of each set.
        state: (K, W, S) initial states at the start.
        nuisance: (K, z) nuisances of the logs.
        iterations: Largest number of simulations.
        tolerance: Fall of the cost of a window below which its states are found.
        sought: (K, W) True where states are searched; None searches all.
        most: (K,) sum of the costs of these windows at most: the search of a set ends where its slopes promise no less;
            None for any.

    Returns:
        States (K, W, S), costs (K, W); infinite costs where none are searched.
    """
    _, count, size = state.shape
    search = StateSearch.at(state)
    if sought is not None:
        search.settled = ~sought
    for iteration in range(iterations):
        moving = (~search.settled).nonzero()
        if len(moving) == 0:
            break
        # Sets and windows in which all states are found are not simulated again.
        rows, columns = moving[:, 0].unique(), moving[:, 1].unique()
        part = problem if len(columns) == count else problem.of_windows(columns)
        some = search.of(rows, columns)
        # With many states, every second iteration from the third on keeps the slopes of the one before.
        fresh = size < MANY_STATES or iteration < 2 or iteration % 2 == 0
        nudge = state_steps(size) if fresh else ()
        # Lanes of one set side by side: what acts in some sets alone is then simulated in their lanes alone.
        count_of = 1 + len(nudge)
        lanes = some.trial[:, None].repeat(1, count_of, 1, 1)
        for s, step in enumerate(nudge):
            lanes[:, 1 + s, :, s] += step
        sets_of = np.repeat(theta[rows.numpy()], count_of, axis=0)
        there = nuisance[rows].repeat_interleave(count_of, 0)
        usual = part.with_usual_steps if fresh else part
        predicted = usual.predict(sets_of, lanes.flatten(0, 1), there)
        predicted = predicted.unflatten(0, (len(rows), count_of)).transpose(0, 1)
        if usual is not part:
            exact = part.predict(theta[rows.numpy()], some.trial, nuisance[rows])
            predicted += exact - predicted[0]
            predicted[0] = exact
        residual = part.weighed(part.windows.value - predicted[0]).flatten(2)
        if fresh:
            differences = torch.tensor(nudge, dtype=torch.float64)[:, None, None, None, None]
            slopes = part.weighed((predicted[1:] - predicted[0]) / differences)
            some.slopes = slopes.flatten(3).permute(1, 2, 0, 3)
        some.judge(residual, tolerance)
        some.propose()
        search.put(rows, columns, some)
        if most is not None:
            least = search.promised()
            least = least if sought is None else torch.where(sought, least, 0.0)
            search.settled |= (~(least.sum(1) <= most))[:, None]
    return search.best, search.cost


def lower_states(
    problem: ShootingProblem,
    theta: np.ndarray,
    starts: Sequence[Tensor],
    nuisance: Tensor,
    costs: tuple[Tensor, Tensor],
    most: Tensor,
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    """Search initial states of K sets in the fewest windows that keep the cost from falling as much as wanted.

    A window whose cost then still is above that before is searched from the next start, too.

    Args:
        problem: The windows.
        theta: (K, P) all parameters of each set.
        starts: Initial states (K, W, S) from which a window is searched in turn; the first are those of the costs.
        nuisance: (K, z) nuisances of the logs.
        costs: Costs (K, W) with the first states, and before.
        most: (K,) cost of all windows that is wanted at most; a search that promises no less ends.
        tolerance: Fall of the cost of a window below which its states are found.

    Returns:
        The best states (K, W, S) of each window, and their costs (K, W).
    """
    (cost, before), states = costs, starts[0].clone()
    order = (cost - before).argsort(dim=1, descending=True, stable=True)
    rise = (cost - before).gather(1, order)
    # By how much the cost is above the wanted one where the windows that rise most, one more each time, do not rise.
    above = (
        torch.nn.functional.pad(rise.flip(1).cumsum(1).flip(1)[:, 1:], (0, 1))
        + (before.sum(1) - most)[:, None]
    )
    fewest = torch.where((above <= 0.0).any(1), (above <= 0.0).int().argmax(1) + 1, (rise > 0.0).sum(1))
    sought = torch.zeros_like(cost, dtype=torch.bool)
    sought.scatter_(1, order, torch.arange(cost.shape[1]) < fewest[:, None])
    cost = cost.clone()
    for start in starts:
        columns = sought.any(0).nonzero()[:, 0]
        if len(columns) == 0:
            break
        found, lowest = search_states(
            problem.of_windows(columns),
            theta,
            start[:, columns],
            nuisance,
            ITERATIONS,
            tolerance,
            sought[:, columns],
            most - torch.where(sought, 0.0, cost).sum(1),
        )
        better = lowest < cost[:, columns]
        states[:, columns] = torch.where(better[..., None], found, states[:, columns])
        cost[:, columns] = torch.where(better, lowest, cost[:, columns])
        sought &= cost > before
    return states, cost

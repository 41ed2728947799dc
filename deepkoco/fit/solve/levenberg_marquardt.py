"""Levenberg-Marquardt for many trials, with one batch of simulations per iteration.

Before a step that raises the cost is shortened, the initial states are searched again at the new parameters, in each
window by itself. No straight step follows the best initial states where a joint sticks, or where a held command enters
a window in a jump when its delay grows. One window out of twenty that goes astray would otherwise hold the parameters
where they are, in all of them.

Source: Golub, Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
separate (1973).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.fit_types import FIRST_DAMPING, MOST_DAMPING, Fit, Trial
from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.solve.covariance import covariance_of
from deepkoco.fit.solve.normal_equations import NormalEquations
from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse
from deepkoco.fit.solve.state_search import lower_states
from deepkoco.fit.tangent import Tangent, batches, simulated

# A fit has converged when a step lowers its cost by less; a fit of many parameters, by less for each of them.
TOLERANCE = 0.02
TO_BEGIN = 0.5  # the same for a fit that only begins another one
LEAST_DAMPING, LARGEST_DAMPING = 1e-9, 1e8
KEPT = 0.25  # share of the fall that a step promises, which it gives with other initial states
LIKELY = 0.75  # share of it from which a longer step may follow then
LARGE = (
    0.125  # of the lanes that are simulated in one batch, from which points are simulated before their slopes
)


class Batch:
    """State of the trials of one call of :meth:`FitProblem.fit`."""

    def __init__(
        self, problem: ShootingProblem, trials: Sequence[Trial], tolerance: float = TOLERANCE
    ) -> None:
        self.problem, self.trials, self.tolerance = problem, trials, tolerance
        names, windows = problem.names, problem.windows
        self.columns = [np.array([names.index(n) for n in t.free], dtype=int) for t in trials]
        self.width = max((len(c) for c in self.columns), default=0)
        self.theta = np.array([[float(t.values[n]) for n in names] for t in trials])
        self.initial = torch.stack([windows.state if t.state is None else t.state for t in trials]).clone()
        right = problem.nuisances.none()
        self.nuisance = torch.stack([right if t.nuisance is None else t.nuisance for t in trials]).clone()
        count = len(trials)
        self.penalties = [t.prior.penalty(t.free) for t in trials]
        self.damping = np.full(count, FIRST_DAMPING)
        self.cost = np.full(count, np.inf)
        self.done = np.zeros(count, dtype=bool)
        self.converged = np.zeros(count, dtype=bool)
        self.history: list[list[float]] = [[] for _ in trials]
        self.normal: list[NormalEquations | None] = [None] * count
        self.predicted = np.full(count, np.inf)  # fall of the cost that the present step promises
        # Whether the present step lowers the cost with other initial states only, and whether none did since the last.
        self.saved, self.vain = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)

    def run(self, iterations: int) -> list[Fit]:
        trial_theta, trial_initial = self.theta.copy(), self.initial.clone()
        trial_nuisance = self.nuisance.clone()
        for iteration in range(iterations):
            active = np.flatnonzero(~self.done)
            if len(active) == 0:
                break
            normals = self._linearise(active, trial_theta, trial_initial, trial_nuisance)
            for k, normal in zip(active, normals, strict=True):
                decrease = self.cost[k] - normal.cost
                # The cost can be finite although a lane of the finite differences diverged.
                if normal.finite and decrease >= 0:
                    self.normal[k], self.vain[k] = normal, False
                    self.theta[k], self.cost[k] = trial_theta[k], normal.cost
                    self.initial[k], self.nuisance[k] = trial_initial[k], trial_nuisance[k]
                    if not self.saved[k] or decrease >= LIKELY * self.predicted[k]:
                        self.damping[k] = max(self.damping[k] * 0.1, LEAST_DAMPING)
                    self.converged[k] = decrease < self._tolerance(int(k))
                else:
                    self.damping[k] *= 20.0
                    # If the step raises the cost by rounding errors only, the cost is at its minimum.
                    self.converged[k] = normal.finite and -decrease < 1e-3 * self._tolerance(int(k))
                self.history[k].append(float(self.cost[k]))
                self.done[k] = (
                    self.converged[k] or self.damping[k] > LARGEST_DAMPING or self.normal[k] is None
                )
                if not self.done[k] and iteration < iterations - 1:
                    try:
                        step = self._step(int(k))
                    except DivergedError:
                        self.done[k] = True
                        continue
                    trial_theta[k], trial_initial[k], trial_nuisance[k], gain = step
                    self.predicted[k] = gain
                    if gain < 0.25 * self._tolerance(int(k)):
                        self.done[k] = self.converged[k] = True
        return [self._result(k) for k in range(len(self.trials))]

    def _search_states(
        self, at: dict[int, NormalEquations], theta: np.ndarray, initial: Tensor, nuisance: Tensor
    ) -> list[int]:
        """Search initial states in the windows that raise the cost; return the trials whose cost is then lower.

        After a search in vain, states are not searched again before a step has been taken.

        Args:
            at: Equations of trials at points that raise their cost; only the residuals are used.
            theta, initial, nuisance: Points of all trials; better initial states are written into them.
        """
        own = [k for k in at if not self.vain[k]]
        if not own:
            return []
        now = torch.stack([_of_windows(at[k]) for k in own]).nan_to_num(torch.inf, posinf=torch.inf)
        before = torch.stack([_of_windows(self.normal[k]) for k in own])
        penalty = np.array([self._penalty(k, theta[k], nuisance[k]) for k in own])
        most = torch.from_numpy(self.cost[own] - penalty - KEPT * self.predicted[own])
        states, costs = lower_states(
            self.problem,
            theta[own],
            (initial[own], self.initial[own]),
            nuisance[own],
            (now, before),
            most,
            TOLERANCE / max(initial.shape[1], 1),
        )
        self.vain[own] = ~(costs.sum(1) <= most).numpy()
        lower = [k for k in own if not self.vain[k]]
        self.saved[lower] = True
        initial[lower] = states[torch.from_numpy(~self.vain[own])]
        return lower

    def _penalty(self, k: int, theta: np.ndarray, nuisance: Tensor) -> float:
        """Return the prior's share of the cost of a trial at a point."""
        prior, offset = map(torch.from_numpy, self.penalties[k].at(theta[self.columns[k]]))
        return float(offset @ prior @ offset) + float(self.problem.nuisances.precision @ nuisance**2)

    def _tolerance(self, k: int) -> float:
        """Return the fall of the cost below which a trial has converged, for residuals of the size that it has.

        A cost far above the number of samples shows model error, and costs are then compared by their ratio.
        """
        return self.tolerance * max(1.0, float(self.cost[k]) / max(self.problem.windows.samples, 1))

    def _linearise(
        self, active: np.ndarray, theta: np.ndarray, initial: Tensor, nuisance: Tensor
    ) -> list[NormalEquations]:
        """Simulate the active trials with their finite differences, a few at a time; form the normal equations."""
        varying = np.array([self.problem.names.index(n) for n in self.problem.nuisances.varies], dtype=int)
        result = self._rejected(active, theta, initial, nuisance)
        result |= self._at_points([k for k in active if k not in result], varying, theta, initial, nuisance)
        self.saved[active] = False
        raised = [k for k in active if self.normal[k] is not None and not result[k].cost <= self.cost[k]]
        lower = self._search_states({k: result[k] for k in raised}, theta, initial, nuisance)
        result |= self._at_points(lower, varying, theta, initial, nuisance)
        return [result[k] for k in active]

    def _at_points(
        self, which: Sequence[int], varying: np.ndarray, theta: np.ndarray, initial: Tensor, nuisance: Tensor
    ) -> dict[int, NormalEquations]:
        """Return the normal equations of some trials at their points."""
        problem, result = self.problem, {}
        moved = [np.append(self.columns[k], np.setdiff1d(varying, self.columns[k])) for k in which]
        tangents = [
            Tangent.at(problem, theta[k], columns, initial[k])
            for k, columns in zip(which, moved, strict=True)
        ]
        these = np.array(which, dtype=int)
        for some in batches([len(tangent) for tangent in tangents], problem.most_lanes):
            predicted, at = simulated(problem, [tangents[i] for i in some], nuisance[these[some]]), 0
            for i in some:
                k, lanes = which[i], predicted[at : at + len(tangents[i])]
                at += len(lanes)
                result[k] = self._equations(k, tangents[i], moved[i], varying, lanes, theta[k], nuisance[k])
        return result

    def _rejected(
        self, active: np.ndarray, theta: np.ndarray, initial: Tensor, nuisance: Tensor
    ) -> dict[int, NormalEquations]:
        """Return the trials whose points raise the cost, with equations that have no slopes: none are needed.

        Where a joint sticks and slips, most steps are rejected. Small problems simulate everything at once.
        """
        problem, later = self.problem, np.array([k for k in active if self.normal[k] is not None], dtype=int)
        lanes = sum(1 + len(self.columns[k]) + initial.shape[2] for k in later)
        if len(later) == 0 or lanes < LARGE * problem.most_lanes:
            return {}
        result = {}
        for k, own in zip(later, problem.predict(theta[later], initial[later], nuisance[later]), strict=True):
            residual = problem.weighed(problem.windows.value - own)
            normal = _of_states(residual[None][:0], residual)
            penalty = self._penalty(k, theta[k], nuisance[k])
            if not normal.chi2 + penalty <= self.cost[k]:
                result[k] = replace(normal, cost=normal.chi2 + penalty)
        return result

    def _equations(
        self,
        k: int,
        tangent: Tangent,
        columns: np.ndarray,
        varying: np.ndarray,
        lanes: Tensor,
        theta: np.ndarray,
        nuisance: Tensor,
    ) -> NormalEquations:
        """Normal equations of a trial from its simulated lanes (1 + q + S, W, N, M)."""
        problem, p = self.problem, len(self.columns[k])
        slopes = tangent.slopes(lanes, problem)
        residual = problem.weighed(problem.windows.value - lanes[0])
        prior, offset = map(torch.from_numpy, self.penalties[k].at(theta[self.columns[k]]))
        own = problem.nuisance_slopes(slopes[[int(np.flatnonzero(columns == v)[0]) for v in varying]])
        states, precision = slopes[len(columns) :], problem.nuisances.precision
        return NormalEquations.build(residual, slopes[:p], states, own, prior, offset, nuisance, precision)

    def _step(self, k: int, damping: float | None = None) -> tuple[np.ndarray, Tensor, Tensor, float]:
        """Return the point of the next step of a trial, and the fall of the cost that it promises.

        Args:
            k: The trial.
            damping: Relative addition to the diagonals; None for the trial's own.

        Raises:
            DivergedError: The reduced equations overflow.
        """
        problem, normal = self.problem, self.normal[k]
        damping = float(self.damping[k]) if damping is None else damping
        assert normal is not None
        columns = self.columns[k]
        p = len(columns)
        at = self.theta[k, columns]
        low, high = problem.low[columns] - at, problem.high[columns] - at
        held = np.zeros(p, dtype=bool)
        limit = np.zeros(p)
        while True:
            move, states, gain = normal.solve(damping, held, limit)
            # Parameters that leave their bounds are set to them, and the step of the others is solved again.
            outside = ((move[:p] < low) | (move[:p] > high)) & ~held
            if not outside.any():
                break
            held |= outside
            limit = np.where(outside, np.clip(move[:p], low, high), limit)
        theta = self.theta[k].copy()
        theta[columns] = np.clip(at + move[:p], problem.low[columns], problem.high[columns])
        return theta, self.initial[k] + states, self.nuisance[k] + torch.from_numpy(move[p:]), gain

    def _promised(self, k: int) -> float:
        """Return the fall of the cost that a step without damping promises at the best point of a trial."""
        try:
            return self._step(k, LEAST_DAMPING)[-1]
        except DivergedError:
            return math.inf

    def _result(self, k: int) -> Fit:
        normal, trial = self.normal[k], self.trials[k]
        p = len(self.columns[k])
        if normal is None:
            return self._diverged(k)
        full = normal.reduced(0.0)[0].numpy()
        if not np.isfinite(full).all():
            return self._diverged(k)
        prior = np.diag(np.append(np.zeros(p), self.problem.nuisances.precision.numpy()))
        prior[:p, :p] = self.penalties[k].at(self.theta[k, self.columns[k]])[0]
        information = full[:p, :p] - prior[:p, :p]
        if len(full) > p:
            across = full[:p, p:]
            information = information - across @ np.linalg.solve(full[p:, p:], across.T)
        covariance = covariance_of(full, prior)[:p, :p]
        return Fit(
            trial.name,
            trial.free,
            dict(zip(self.problem.names, map(float, self.theta[k]), strict=True)),
            covariance,
            information,
            self.initial[k].clone(),
            self.nuisance[k].clone(),
            normal.chi2,
            normal.cost - normal.chi2,
            normal.residual,
            full,
            self.history[k],
            bool(self.converged[k]),
            promised=self._promised(k),
            damping=float(np.clip(self.damping[k], FIRST_DAMPING, MOST_DAMPING)),
        )

    def _diverged(self, k: int) -> Fit:
        """Result of a trial whose simulation diverges: start values and prior, without information of the data."""
        trial, p = self.trials[k], len(self.columns[k])
        prior = self.penalties[k].at(self.theta[k, self.columns[k]])[0]
        curvature = np.diag(np.append(np.zeros(p), self.problem.nuisances.precision.numpy()))
        curvature[:p, :p] = prior
        return Fit(
            trial.name,
            trial.free,
            dict(zip(self.problem.names, map(float, self.theta[k]), strict=True)),
            scaled_inverse(prior),
            np.zeros((p, p)),
            self.initial[k].clone(),
            self.nuisance[k].clone(),
            np.inf,
            0.0,
            torch.zeros_like(self.problem.weight),
            curvature,
            self.history[k],
        )


def _of_windows(normal: NormalEquations | None) -> Tensor:
    """Cost (W,) of each window, without any penalty."""
    assert normal is not None
    return (normal.residual**2).flatten(1).sum(1)


def _of_states(slopes: Tensor, residual: Tensor) -> NormalEquations:
    """Equations of the initial states alone, with their slopes (S, W, N, M) at a point, without any penalty."""
    none, square = torch.zeros(0, dtype=torch.float64), torch.zeros(0, 0, dtype=torch.float64)
    return NormalEquations.build(residual, slopes[:0], slopes, slopes[:0], square, none, none, none)

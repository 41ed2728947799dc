"""Levenberg-Marquardt for many trials, with one batch of simulations per iteration.

A step that raises the cost is corrected once or twice before it is shortened: the initial states of the windows are
solved again at the new parameters. A command that is held from sample to sample enters a window in jumps when its
delay grows, so the best initial states move along a broken line, which no straight step follows.

Source: Nocedal, Wright, Numerical Optimization (2006), sec. 15.6, second-order correction; Golub, Pereyra, The
differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate (1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.solve.covariance import covariance_of
from deepkoco.fit.solve.normal_equations import NormalEquations
from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse
from deepkoco.fit.tangent import Tangent, batches, simulated

TOLERANCE = 0.02  # a fit has converged when a step lowers its cost by less
LARGEST_DAMPING = 1e8
CORRECTIONS = 2  # of the initial states, for each step
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
        self.damping = np.full(count, 1e-4)
        self.cost = np.full(count, np.inf)
        self.done = np.zeros(count, dtype=bool)
        self.converged = np.zeros(count, dtype=bool)
        self.history: list[list[float]] = [[] for _ in trials]
        self.normal: list[NormalEquations | None] = [None] * count
        self.corrections = np.zeros(count, dtype=int)  # since the last step

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
                    self.normal[k] = normal
                    self.theta[k], self.cost[k] = trial_theta[k], normal.cost
                    self.initial[k], self.nuisance[k] = trial_initial[k], trial_nuisance[k]
                    self.damping[k] = max(self.damping[k] * 0.1, 1e-9)
                    self.converged[k] = decrease < self._tolerance(int(k))
                elif (states := self._correction(int(k), normal)) is not None:
                    trial_initial[k] += states
                    self.history[k].append(float(self.cost[k]))
                    continue
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
                    self.corrections[k] = 0
                    if gain < 0.25 * self._tolerance(int(k)):
                        self.done[k] = self.converged[k] = True
        return [self._result(k) for k in range(len(self.trials))]

    def _correction(self, k: int, normal: NormalEquations) -> Tensor | None:
        """Return the move (W, S) of the initial states alone from a rejected point, None where it promises too little.

        Args:
            k: The trial.
            normal: Equations at the rejected point.
        """
        if self.corrections[k] >= CORRECTIONS or not normal.finite or self.normal[k] is None:
            return None
        states, gain = normal.states_alone()
        if not normal.cost - gain < self.cost[k]:
            return None
        self.corrections[k] += 1
        return states

    def _tolerance(self, k: int) -> float:
        """Return the fall of the cost below which a trial has converged, for residuals of the size that it has.

        A cost far above the number of samples shows model error, and costs are then compared by their ratio.
        """
        return self.tolerance * max(1.0, float(self.cost[k]) / max(self.problem.windows.samples, 1))

    def _linearise(
        self, active: np.ndarray, theta: np.ndarray, initial: Tensor, nuisance: Tensor
    ) -> list[NormalEquations]:
        """Simulate the active trials with their finite differences, a few at a time; form the normal equations."""
        problem = self.problem
        varying = np.array([problem.names.index(n) for n in problem.nuisances.varies], dtype=int)
        moved = {k: np.append(self.columns[k], np.setdiff1d(varying, self.columns[k])) for k in active}
        result = self._rejected(active, theta, initial, nuisance)
        # Slopes at a rejected point correct its initial states, if these may be corrected once more.
        alone = {k for k in result if self.corrections[k] < CORRECTIONS}
        pending = np.array([k for k in active if k not in result or k in alone], dtype=int)
        moved |= {k: moved[k][:0] for k in alone}
        tangents = [Tangent.at(problem, theta[k], moved[k], initial[k]) for k in pending]
        for some in batches([len(tangent) for tangent in tangents], problem.most_lanes):
            own = [tangents[i] for i in some]
            predicted, at = simulated(problem, own, nuisance[pending[some]]), 0
            for tangent, k in zip(own, pending[some], strict=True):
                lanes = predicted[at : at + len(tangent)]
                at += len(lanes)
                if k in alone:
                    known = _of_states(tangent.slopes(lanes, problem.weight), result[k].residual)
                    result[k] = replace(known, cost=result[k].cost)
                else:
                    result[k] = self._equations(k, tangent, moved[k], varying, lanes, theta[k], nuisance[k])
        return [result[k] for k in active]

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
            residual = (problem.windows.value - own) * problem.weight
            normal = _of_states(residual[None][:0], residual)
            prior, offset = map(torch.from_numpy, self.penalties[k].at(theta[k, self.columns[k]]))
            penalty = float(offset @ prior @ offset) + float(problem.nuisances.precision @ nuisance[k] ** 2)
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
        slopes = tangent.slopes(lanes, problem.weight)
        residual = (problem.windows.value - lanes[0]) * problem.weight
        prior, offset = map(torch.from_numpy, self.penalties[k].at(theta[self.columns[k]]))
        own = problem.nuisance_slopes(slopes[[int(np.flatnonzero(columns == v)[0]) for v in varying]])
        states, precision = slopes[len(columns) :], problem.nuisances.precision
        return NormalEquations.build(residual, slopes[:p], states, own, prior, offset, nuisance, precision)

    def _step(self, k: int) -> tuple[np.ndarray, Tensor, Tensor, float]:
        problem, normal = self.problem, self.normal[k]
        assert normal is not None
        columns = self.columns[k]
        p = len(columns)
        at = self.theta[k, columns]
        low, high = problem.low[columns] - at, problem.high[columns] - at
        held = np.zeros(p, dtype=bool)
        limit = np.zeros(p)
        while True:
            move, states, gain = normal.solve(self.damping[k], held, limit)
            # Parameters that leave their bounds are set to them, and the step of the others is solved again.
            outside = ((move[:p] < low) | (move[:p] > high)) & ~held
            if not outside.any():
                break
            held |= outside
            limit = np.where(outside, np.clip(move[:p], low, high), limit)
        theta = self.theta[k].copy()
        theta[columns] = np.clip(at + move[:p], problem.low[columns], problem.high[columns])
        return theta, self.initial[k] + states, self.nuisance[k] + torch.from_numpy(move[p:]), gain

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


def _of_states(slopes: Tensor, residual: Tensor) -> NormalEquations:
    """Equations of the initial states alone, with their slopes (S, W, N, M) at a point, without any penalty."""
    none, square = torch.zeros(0, dtype=torch.float64), torch.zeros(0, 0, dtype=torch.float64)
    return NormalEquations.build(residual, slopes[:0], slopes, slopes[:0], square, none, none, none)

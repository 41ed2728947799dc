"""Levenberg-Marquardt with slopes that are kept as long as they predict the steps: for many parameters.

A simulation for each of 70 parameters and 12 initial states costs as much as 80 steps with known slopes. Steps use the
slopes of an earlier point, mended by what each step has shown, while they lower the cost by about as much as these
slopes predict. Otherwise, and before a fit is called converged, the slopes are computed again.

Where a straight step has raised the cost, steps follow the curvature of the valley.

Source: Kelley, Solving Nonlinear Equations with Newton's Method (2003), ch. 2 and 4: chord and Broyden's methods.
Transtrum, Sethna, Improvements to the Levenberg-Marquardt algorithm for nonlinear least-squares minimization (2012):
geodesic acceleration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.fit_types import FIRST_DAMPING, STUCK, Fit, Trial
from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes, slopes_at, varying
from deepkoco.fit.solve.levenberg_marquardt import LARGEST_DAMPING, LEAST_DAMPING, LIKELY, TOLERANCE, Batch
from deepkoco.fit.solve.normal_equations import NormalEquations
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.fit.tangent import Tangent, simulated

MANY = 20  # parameters and initial states from which slopes are kept
POOR = 0.2  # share of the predicted fall of the cost below which they are computed again
MATTERS = 0.01  # promise of one parameter, as a share of the largest, from which its slopes are computed again first
LANES = 256  # simulations in one batch
# Scale of a change of an initial state [rad or m, per s], beside prior standard deviations of parameters, when what a
# step has shown is shared out.
POSITION_SCALE, SPEED_SCALE = 0.1, 1.0
MOST_TOLERANCE = 1.0  # of all parameters together: costs that differ by a few are told apart
STEPS = 3  # with kept slopes, for each iteration that is allowed
PROBE = 0.1  # share of a step to both sides at which the curvature along it is looked at
MOST_CURVED = 0.75  # length of twice the added step, as a share of the straight one, up to which it is added


class LazyBatch(Batch):
    """State of the trials of one call of :meth:`FitProblem.fit`.

    Args:
        problem, trials: As for :class:`.Batch`.
        tolerance: Of the cost, as there; for each parameter, where it is ``TOLERANCE`` or less, and ``MOST_TOLERANCE``
            for all of them at most.
        known: Slopes from which the trials start; None computes them at the start of each trial. They have every
            parameter that a trial frees and does not renew.
        exact: Whether a fit ends with slopes at its own point. Without, it may end with older ones.
        renewals: How often a trial may compute its slopes again; None for half of the iterations.
    """

    def __init__(
        self,
        problem: ShootingProblem,
        trials: Sequence[Trial],
        tolerance: float = TOLERANCE,
        known: FrozenSlopes | None = None,
        exact: bool = True,
        renewals: int | None = None,
    ) -> None:
        super().__init__(problem, trials, tolerance)
        self.exact, self.most = exact, renewals
        count = len(trials)
        self.damping = np.array([t.damping for t in trials])
        self.slopes: list[FrozenSlopes | None] = [known] * count
        self.renewed = [
            tuple(n for n in t.free if n in t.renew or (known is not None and n not in known.names))
            for t in trials
        ]
        self.current = np.zeros(count, dtype=bool)  # slopes are those of the best point
        self.renewing = np.full(count, known is None)
        self.left = np.zeros(count, dtype=int)
        self.whole = np.ones(count, dtype=bool)  # all slopes are computed again, not only those that matter
        self.partly = np.zeros(count, dtype=bool)  # the latter were computed at the best point
        self.fresh: list[dict[str, Tensor]] = [{}] * count
        # Whether a step has raised the cost since the last one that was taken.
        self.refused = np.zeros(count, dtype=bool)
        self.too_little = np.zeros(count)  # largest damping with which a step has raised the cost
        self.curved = np.zeros(count, dtype=bool)  # a step with slopes of its point has raised the cost

    def run(self, iterations: int) -> list[Fit]:
        points = self.theta.copy(), self.initial.clone(), self.nuisance.clone()
        self.left = np.full(len(self.trials), iterations // 2 + 1 if self.most is None else self.most)
        last = STEPS * (iterations - 1)
        for iteration in range(last + 1):
            active = np.flatnonzero(~self.done)
            if len(active) == 0:
                break
            for k, normal in self._normals(active, points).items():
                if self.normal[k] is not None and self.renewing[k]:
                    self._renew(k, normal)
                else:
                    self._judge(k, normal, points)
                if not (self.done[k] or self.renewing[k]) and iteration < last:
                    self._propose(k, points)
                if self.renewing[k]:
                    points[0][k], points[1][k], points[2][k] = (
                        self.theta[k], self.initial[k], self.nuisance[k]
                    )  # fmt: skip
        return [replace(self._result(k), exact=bool(self.current[k])) for k in range(len(self.trials))]

    def _normals(
        self, active: np.ndarray, points: tuple[np.ndarray, Tensor, Tensor]
    ) -> dict[int, NormalEquations]:
        """Return the equations at the points, with other initial states where these lower the cost."""
        result = dict(zip(active.tolist(), self._evaluate(active, *points), strict=True))
        stepped = [k for k in result if self.normal[k] is not None and not self.renewing[k]]
        raised = [k for k in stepped if not result[k].cost <= self.cost[k]]
        lower = np.array(self._search_states({k: result[k] for k in raised}, *points), dtype=int)
        return result | dict(zip(lower.tolist(), self._evaluate(lower, *points), strict=True))

    def _judge(self, k: int, normal: NormalEquations, points: tuple[np.ndarray, Tensor, Tensor]) -> None:
        """Accept or reject a point."""
        decrease = self.cost[k] - normal.cost
        first = self.normal[k] is None
        fresh, self.renewing[k] = bool(self.renewing[k]), False
        if normal.finite and decrease >= 0:
            if not (first or fresh) and self.most != 0:
                normal = self._mended(k, normal, points)
            self.normal[k], self.cost[k], self.vain[k] = normal, normal.cost, False
            self.theta[k], self.initial[k], self.nuisance[k] = (part[k] for part in points)
            self.current[k], self.partly[k] = fresh, False
            if not first:
                # A step that was refused with less damping would be refused again.
                if not self.refused[k] and decrease >= LIKELY * self.predicted[k]:
                    self.damping[k] = max(self.damping[k] * 0.1, LEAST_DAMPING)
                self.refused[k] = False
                if decrease < self._tolerance(k):
                    if not self._steps_farther(k):
                        self._settle(k)
                elif decrease < POOR * self.predicted[k]:
                    self._ask_for_slopes(k)
        elif first:
            self.done[k] = True
        elif self.current[k] or not self._ask_for_slopes(k):
            self.refused[k], self.too_little[k] = True, max(self.too_little[k], self.damping[k])
            self.damping[k] *= 20.0
            self.curved[k] |= self.current[k]
            # If the step raises the cost by rounding errors only, the cost is at its minimum.
            if normal.finite and -decrease < 1e-3 * self._tolerance(k):
                self._settle(k)
            self.done[k] |= self.damping[k] > LARGEST_DAMPING
        self.history[k].append(float(self.cost[k]))

    def _mended(
        self, k: int, normal: NormalEquations, points: tuple[np.ndarray, Tensor, Tensor]
    ) -> NormalEquations:
        """Mend the slopes by what the step to a point has shown; return the equations there."""
        slopes, before, problem = self.slopes[k], self.normal[k], self.problem
        assert slopes is not None
        assert before is not None
        columns = np.array([problem.names.index(n) for n in slopes.names], dtype=int)
        spread = np.concatenate([problem.scale[columns], problem.nuisances.spread])
        own = torch.from_numpy(points[0][k, columns] - self.theta[k, columns])
        own = torch.cat([own, points[2][k] - self.nuisance[k]])
        states = points[1][k] - self.initial[k]
        shown = (before.residual - normal.residual).flatten(1)
        expected = (own @ slopes.rows.flatten(1)).view_as(shown) + (slopes.states @ states[..., None])[..., 0]
        for name, slope in self.fresh[k].items():
            i = problem.names.index(name)
            there = slopes.rows[slopes.names.index(name)] if name in slopes.names else 0.0
            expected = expected + float(points[0][k, i] - self.theta[k, i]) * (slope.flatten(1) - there)
        half = states.shape[1] // 2
        scale = torch.tensor([POSITION_SCALE] * half + [SPEED_SCALE] * half, dtype=torch.float64)
        kept = torch.tensor([n not in self.fresh[k] for n in slopes.names] + [True] * len(points[2][k]))
        moved = torch.where(kept, own / torch.from_numpy(spread), 0.0)
        size = (moved**2).sum() + ((states / scale) ** 2).sum(1)
        missed = (shown - expected) / size.clamp_min(1e-30)[:, None]
        slopes = slopes.after(moved / torch.from_numpy(spread), states / scale**2, missed)
        self.slopes[k] = slopes
        return self._built(k, normal.residual, points[0][k], points[2][k])

    def _tolerance(self, k: int) -> float:
        """As for few parameters, but ``TOLERANCE`` for each parameter, or less where less is asked for.

        With ``TOLERANCE``, each parameter may be off by a seventh of its standard deviation. All of them together have
        ``MOST_TOLERANCE`` at most.
        """
        whole = min(min(self.tolerance, TOLERANCE) * len(self.trials[k].free), MOST_TOLERANCE)
        usual = super()._tolerance(k)
        return usual if whole <= self.tolerance else usual * whole / self.tolerance

    def _ask_for_slopes(self, k: int, whole: bool = False) -> bool:
        """Let the next simulations give slopes at the best point, if the trial may have them: first those that matter.

        Args:
            k: The trial.
            whole: Whether all slopes are computed again.
        """
        if self.left[k] > 0:
            self.left[k] -= 1
            self.renewing[k], self.whole[k] = True, whole or self.partly[k]
        return bool(self.renewing[k])

    def _renew(self, k: int, normal: NormalEquations) -> None:
        """Take new slopes at the best point."""
        self.renewing[k] = False
        if normal.finite:
            self.normal[k], self.current[k], self.partly[k] = normal, self.whole[k], True
        else:
            # The cost is finite although a lane of the finite differences diverged.
            self.done[k] = True

    def _steps_farther(self, k: int) -> bool:
        """Lower the damping, where this fit has not yet found that less is too little.

        Damping shortens a step most along what the measurements tell least. A step that promises little with it may
        promise more without. Where it promises a large share of the cost, the fit is stuck far from its minimum, and a
        straight step leads nowhere.
        """
        lower = 0.1 * self.damping[k]
        if lower < LEAST_DAMPING or lower <= self.too_little[k]:
            return False
        if lower < FIRST_DAMPING and self._promised(k) > STUCK * self.cost[k]:
            return False
        self.damping[k] = lower
        return True

    def _settle(self, k: int) -> None:
        """End a trial whose steps no longer lower the cost, or renew its slopes before."""
        if not self.exact or self.current[k] or not self._ask_for_slopes(k, whole=True):
            self.done[k] = self.converged[k] = True

    def _propose(self, k: int, points: tuple[np.ndarray, Tensor, Tensor]) -> None:
        try:
            theta, initial, nuisance, gain = self._step(k)
            while gain < 0.25 * self._tolerance(k) and self._steps_farther(k):
                theta, initial, nuisance, gain = self._step(k)
        except DivergedError:
            self.done[k] = True
            return
        if self.curved[k]:
            theta, initial, nuisance = self._bent(k, theta, initial, nuisance)
        points[0][k], points[1][k], points[2][k] = theta, initial, nuisance
        self.predicted[k] = gain
        if gain < 0.25 * self._tolerance(k):
            self._settle(k)

    def _bent(
        self, k: int, theta: np.ndarray, initial: Tensor, nuisance: Tensor
    ) -> tuple[np.ndarray, Tensor, Tensor]:
        """Return a step that follows a curved valley, if its curvature is small enough to be known from one step.

        Where a load on a link trades against the mass and the centre of mass of this link, all sets that show the same
        moments lie on a curve. Along a straight step the residuals grow with its square, so that only steps of a few
        per cent lower the cost. Half of the second derivative along the step, as it would be fitted, is added to it.
        """
        problem, slopes, columns = self.problem, self.slopes[k], self.columns[k]
        normal = self.normal[k]
        assert slopes is not None
        assert normal is not None
        way = theta - self.theta[k], initial - self.initial[k], nuisance - self.nuisance[k]
        sides = np.array([-PROBE, PROBE])
        inside = np.clip(self.theta[k] + sides[:, None] * way[0], problem.low, problem.high)
        shown = problem.predict(
            inside,
            self.initial[k] + torch.from_numpy(sides)[:, None, None] * way[1],
            self.nuisance[k] + torch.from_numpy(sides)[:, None] * way[2],
        )
        # Predictions around the point, in standard deviations: their second difference is that of the residuals.
        here = (problem.weighed(problem.windows.value) - normal.residual) * 2.0
        second = (problem.weighed(shown).sum(0) - here).flatten(1) / PROBE**2
        if not bool(torch.isfinite(second).all()):
            return theta, initial, nuisance
        p, free = len(columns), self.trials[k].free
        rows = [
            self.fresh[k][n].flatten(1) if n in self.fresh[k] else slopes.rows[slopes.names.index(n)]
            for n in free
        ]
        own = torch.stack([*rows, *slopes.rows[len(slopes.names) :]])
        pull = replace(
            normal,
            gp=-0.5 * torch.einsum("qwm,wm->q", own, second),
            gs=-0.5 * torch.einsum("wms,wm->ws", slopes.states, second),
        )
        try:
            move, states, _ = pull.solve(self.damping[k], np.zeros(p, dtype=bool), np.zeros(p))
        except DivergedError:  # beside the point the simulation runs away: the straight step stands
            return theta, initial, nuisance
        spread = np.concatenate([problem.scale[columns], problem.nuisances.spread])
        along = np.concatenate([way[0][columns], way[2].numpy()]) / spread
        if 2.0 * float(np.linalg.norm(move / spread)) > MOST_CURVED * float(np.linalg.norm(along)):
            return theta, initial, nuisance
        bent = theta.copy()
        bent[columns] = np.clip(theta[columns] + move[:p], problem.low[columns], problem.high[columns])
        return bent, initial + states, nuisance + torch.from_numpy(move[p:])

    def _that_matter(self, k: int) -> list[str]:
        """Return the parameters whose steps promise much, and those whose slopes are always computed."""
        normal, free = self.normal[k], self.trials[k].free
        assert normal is not None
        p = len(free)
        if p == 0:
            return []
        promise = normal.gp[:p] ** 2 / torch.diagonal(normal.hpp)[:p].clamp_min(1e-300)
        matters = promise >= MATTERS * promise.max()
        slopes = self.slopes[k]
        known = () if slopes is None else slopes.names
        return [
            n
            for n, yes in zip(free, matters.tolist(), strict=True)
            if n in known and (yes or n in self.renewed[k])
        ]

    def _evaluate(
        self, active: np.ndarray, theta: np.ndarray, initial: Tensor, nuisance: Tensor
    ) -> list[NormalEquations]:
        """Simulate the points of the active trials, with the lanes that each needs, in batches."""
        problem, tangents, names = self.problem, [], []
        for k in active:
            free = self.trials[k].free
            renewing = bool(self.renewing[k])
            if renewing and self.whole[k]:
                moved = [*free, *varying(problem, free)]
            else:
                moved = self._that_matter(k) if renewing else list(self.renewed[k])
            columns = np.array([problem.names.index(n) for n in moved], dtype=int)
            tangents.append(Tangent.at(problem, theta[k], columns, initial[k], states=renewing))
            names.append(moved)
        result: list[NormalEquations] = []
        at = 0
        while at < len(active):
            stop, lanes = at + 1, len(tangents[at])
            while stop < len(active) and lanes + len(tangents[stop]) <= LANES:
                lanes += len(tangents[stop])
                stop += 1
            some = tangents[at:stop]
            predicted = simulated(problem, some, nuisance[active[at:stop]])
            first = 0
            for i in range(at, stop):
                own = predicted[first : first + len(tangents[i])]
                first += len(tangents[i])
                k = active[i]
                result.append(self._equations(k, tangents[i], names[i], own, theta[k], nuisance[k]))
            at = stop
        return result

    def _equations(
        self,
        k: int,
        tangent: Tangent,
        moved: Sequence[str],
        lanes: Tensor,
        theta: np.ndarray,
        nuisance: Tensor,
    ) -> NormalEquations:
        problem, free = self.problem, self.trials[k].free
        residual = problem.weighed(problem.windows.value - lanes[0])
        fresh: dict[str, Tensor] = {}
        slopes = self.slopes[k]
        if self.renewing[k] and (self.whole[k] or slopes is None):
            self.slopes[k] = slopes_at(problem, tangent, lanes, free)
        elif self.renewing[k]:
            assert slopes is not None
            self.slopes[k] = slopes.replaced(moved, tangent.slopes(lanes, problem))
            fresh = {n: s for n, s in self.fresh[k].items() if n not in slopes.names}
        else:
            fresh = dict(zip(moved, tangent.slopes(lanes, problem), strict=True))
        self.fresh[k] = fresh
        return self._built(k, residual, theta, nuisance)

    def _built(self, k: int, residual: Tensor, theta: np.ndarray, nuisance: Tensor) -> NormalEquations:
        """Normal equations of a trial at a point, with the slopes that it has."""
        free, slopes = self.trials[k].free, self.slopes[k]
        assert slopes is not None
        prior, offset = map(torch.from_numpy, self.penalties[k].at(theta[self.columns[k]]))
        return slopes.equations(self.problem, free, self.fresh[k], residual, prior, offset, nuisance)

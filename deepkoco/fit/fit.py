"""Levenberg-Marquardt on multiple shooting, many trials in one batch, initial states eliminated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows, halved
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.shooting import ShootingProblem, channel_delays
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes, slopes_at, varying
from deepkoco.fit.solve.lazy_batch import MANY, LazyBatch
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE, Batch
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse
from deepkoco.fit.tangent import Tangent, state_steps

__all__ = ["Fit", "FitProblem", "Trial", "channel_delays"]

MANY_STATES = 8  # in a window, from which a fit of states keeps slopes for a second iteration


class FitProblem(ShootingProblem):
    """Windows of measurements of one system, to which trials are fitted.

    The cost of a trial is the squared whitened simulation error over all windows, plus the prior's penalty. Every
    trial also fits the initial states of the windows and the nuisances of the logs. Nuisances are encoder zeros and
    differences of parameters that vary from log to log. A Schur complement eliminates the initial states from the
    normal equations. The time of a step therefore grows linearly with the number of windows.

    Args:
        system: The extended system; trials free some of its parameters.
        windows: Data.
        late: Channels that may lag behind their time stamps. Each has its own delay, the parameter
            ``<channel>.delay`` [s]; 0 is no lag.
        zero_sd: Standard deviation of encoder zeros from log to log [rad]; None takes the channels' declarations.

    Source: Bock, Recent advances in parameter identification (1983) for multiple shooting;
        Nocedal and Wright, Numerical Optimization, ch. 10 for Levenberg-Marquardt.
    """

    def recentred(self, fit: Fit) -> Fit:
        """Express a fit by the sample mean of its logs and their differences from it; the predictions stay the same.

        A fit estimates the population mean of parameters that vary. The sample mean of its logs can differ from it.
        """
        if not self.nuisances.varies:
            return fit
        count, seen, values = len(fit.free), np.unique(self.windows.log), self.values_in(fit)
        average = np.eye(count, len(fit.curvature))
        nuisance = fit.nuisance.clone()
        for name in self.nuisances.varies:
            own = [self.nuisances.index(name, log) for log in range(self.zeros.logs)]
            these = [own[log] for log in seen]
            if name in fit.free:
                average[fit.free.index(name), [count + k for k in these]] = 1.0 / len(these)
            nuisance[own] += fit.values[name] - values[name]
        covariance = average @ scaled_inverse(fit.curvature) @ average.T
        return replace(fit, values=values, covariance=covariance, nuisance=nuisance)

    def elsewhere(self, windows: Windows, fit: Fit) -> Windows:
        """Set the fitted differences of the logs as known in other windows of the same logs.

        Windows that have parameters that vary, or a problem without any, are returned as they are.
        """
        if windows.varies or not self.nuisances.varies:
            return windows
        return self.nuisances.known_in(windows, fit.nuisance)

    def as_fitted(self, fit: Fit) -> tuple[FitProblem, Fit]:
        """The problem in which the fitted differences of the logs are known, and the same fit of that problem."""
        if not self.nuisances.varies:
            return self, fit
        known = FitProblem(
            self.system, self.nuisances.known_in(self.windows, fit.nuisance), self._late, self._zero_sd
        )
        count = len(fit.free) + self.zeros.count
        curvature = fit.curvature[:count, :count]
        return known, replace(fit, nuisance=fit.nuisance[: self.zeros.count], curvature=curvature)

    def fit(
        self,
        trials: Sequence[Trial],
        iterations: int = 25,
        tolerance: float = TOLERANCE,
        known: FrozenSlopes | None = None,
        exact: bool = True,
        renewals: int | None = None,
    ) -> list[Fit]:
        """Fit all trials. Every iteration simulates all trials that have not converged in one batch.

        With many parameters, slopes are computed only where those of an earlier point predict too poorly
        (:class:`.LazyBatch`).

        Args:
            trials: What to fit.
            iterations: Largest number of simulations of a trial.
            tolerance: A trial has converged when a step lowers its cost by less.
            known: Slopes near the starts of the trials, of which most are then not computed; None computes them.
            exact: Whether fits end with slopes at their own points. Without, covariances may be of earlier points.
            renewals: How often a trial that keeps slopes may compute them again; None for half of the iterations.

        Returns:
            One fit per trial; its :attr:`.Fit.diverged` is True if the simulation diverges at the start values.
        """
        if not trials:
            return []
        if known is not None or self.keeps_slopes(trials):
            return LazyBatch(self, trials, tolerance, known, exact, renewals).run(iterations)
        return Batch(self, trials, tolerance).run(iterations)

    def keeps_slopes(self, trials: Sequence[Trial]) -> bool:
        """Return whether trials have so many parameters that slopes are kept from step to step."""
        return max((len(t.free) for t in trials), default=0) + self.windows.state.shape[1] >= MANY

    def slopes_at(
        self, values: Mapping[str, float], names: Sequence[str], state: Tensor, nuisance: Tensor
    ) -> FrozenSlopes:
        """Return the slopes of the measurements at one point.

        Args:
            values: All parameters.
            names: Parameters whose slopes are computed.
            state: (W, S) initial states.
            nuisance: (z,) nuisances of the logs.
        """
        theta = np.array([float(values[n]) for n in self.names])
        columns = np.array([self.names.index(n) for n in (*names, *varying(self, names))], dtype=int)
        tangent = Tangent.at(self, theta, columns, state)
        lanes = self.predict(tangent.theta, tangent.state, nuisance[None].repeat(len(tangent), 1))
        return slopes_at(self, tangent, lanes, names)

    def fit_one(self, trial: Trial, iterations: int = 25, tolerance: float = TOLERANCE) -> Fit:
        """As :meth:`fit` for one trial, but raises if it diverges.

        Raises:
            DivergedError: The simulation diverges at the start values.
        """
        fit = self.fit([trial], iterations, tolerance)[0]
        if fit.diverged:
            raise DivergedError(
                f"{trial.name}: the simulation of {self.system.base.name} diverges at {self._far_from_nominal(fit)}"
            )
        return fit

    def _far_from_nominal(self, fit: Fit) -> str:
        """Describe the parameters that are farthest from their declared values."""
        declared = [p for p in self.system.parameters if p.name in fit.values and p.prior_sd > 0.0]
        away = [abs(fit.values[p.name] - p.value) / p.prior_sd for p in declared]
        far = sorted(
            (p for p, a in zip(declared, away, strict=True) if a > 0.0),
            key=lambda p: -away[declared.index(p)],
        )
        if not far:
            return "the values that are declared"
        return ", ".join(f"{p.name} = {fit.values[p.name]:.4g} {p.unit}" for p in far[:3])

    def evaluate(self, values: Mapping[str, float], name: str = "", state: Tensor | None = None) -> Fit:
        """Fit initial states and nuisances only, with every parameter held at ``values``.

        Each window uses the best of three starts: its first guess, the fit of its first half, and ``state`` (W, S)
        if given. The first half is a start because a shorter window has fewer local minima.
        """
        halves = FitProblem(self.system, halved(self.windows))
        starts = [self.windows.state, halves.fit_states(values, halves.windows.state)[0][::2]]
        starts += [] if state is None else [state]
        states, costs = self.fit_states_each([values] * len(starts), torch.stack(starts))
        pick = costs.argmin(0)[None, :, None].expand(1, -1, self.windows.state.shape[1])
        first = states.gather(0, pick)[0]
        return self.fit_one(Trial(name, (), Prior.empty(), values, first), 12 if self.nuisances.count else 1)

    def fit_states(
        self, values: Mapping[str, float], state: Tensor, iterations: int = 15
    ) -> tuple[Tensor, Tensor]:
        """Fit the initial states (W, S) at fixed parameters; also returns the cost (W,) of each window."""
        states, costs = self.fit_states_each([values], state[None], iterations)
        return states[0], costs[0]

    def fit_states_each(
        self,
        values: Sequence[Mapping[str, float]],
        state: Tensor,
        iterations: int = 15,
        nuisance: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """As :meth:`fit_states` for K sets of parameters and start states (K, W, S) in one batch.

        At fixed parameters the windows are independent, so each has its own step and damping.

        Args:
            values: Parameters of each set.
            state: (K, W, S) initial states at the start.
            iterations: Largest number of simulations.
            nuisance: (K, z) nuisances of the logs; None for zeros.

        Returns:
            States (K, W, S), costs (K, W).
        """
        sets, count, size = state.shape
        nuisance = self.nuisances.none().repeat(sets, 1) if nuisance is None else nuisance
        theta = np.array([[float(v[n]) for n in self.names] for v in values])
        search = _StateSearch.at(state)
        for iteration in range(iterations):
            moving = (~search.settled).nonzero()
            if len(moving) == 0:
                break
            # Sets and windows in which all states are found are not simulated again.
            rows, columns = moving[:, 0].unique(), moving[:, 1].unique()
            part = self if len(columns) == count else self.of_windows(columns)
            some = search.of(rows, columns)
            # With many states, every second iteration from the third on keeps the slopes of the one before.
            fresh = size < MANY_STATES or iteration < 2 or iteration % 2 == 0
            nudge = state_steps(size) if fresh else ()
            lanes = some.trial.repeat(1 + len(nudge), 1, 1, 1)
            for s, step in enumerate(nudge):
                lanes[1 + s, :, :, s] += step
            predicted = part.predict(
                np.tile(theta[rows.numpy()], (len(lanes), 1)),
                lanes.flatten(0, 1),
                nuisance[rows].repeat(len(lanes), 1),
            ).unflatten(0, (len(lanes), len(rows)))
            residual = ((part.windows.value - predicted[0]) * part.weight).flatten(2)
            if fresh:
                differences = torch.tensor(nudge, dtype=torch.float64)[:, None, None, None, None]
                slopes = (predicted[1:] - predicted[0]) / differences * part.weight
                some.slopes = slopes.flatten(3).permute(1, 2, 0, 3)
            some.judge(residual, TOLERANCE / count)
            some.propose()
            search.put(rows, columns, some)
        return search.best, search.cost


@dataclass
class _StateSearch:
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
    def at(state: Tensor) -> _StateSearch:
        """Begin at states (K, W, S)."""
        sets, count, size = state.shape
        return _StateSearch(
            state.clone(),
            state.clone(),
            torch.full((sets, count), torch.inf, dtype=torch.float64),
            torch.full((sets, count), 1e-3, dtype=torch.float64),
            torch.zeros(sets, count, dtype=torch.bool),
            torch.eye(size, dtype=torch.float64).repeat(sets, count, 1, 1),
            torch.zeros(sets, count, size, dtype=torch.float64),
            torch.zeros(sets, count, size, 0, dtype=torch.float64),
        )

    def of(self, rows: Tensor, columns: Tensor) -> _StateSearch:
        """The search of some sets and windows."""
        return _StateSearch(*(getattr(self, f.name)[rows][:, columns] for f in fields(self)))

    def put(self, rows: Tensor, columns: Tensor, part: _StateSearch) -> None:
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

    def propose(self) -> None:
        """Take a damped step from the best states."""
        diagonal = torch.diagonal(self.hessian, dim1=-2, dim2=-1)
        matrix = self.hessian + torch.diag_embed(self.damping[..., None] * diagonal + 1e-9)
        step, singular = torch.linalg.solve_ex(matrix, self.gradient)
        self.trial = self.best + torch.where((singular == 0)[..., None], step, 0.0)

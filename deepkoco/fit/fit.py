"""Levenberg-Marquardt on multiple shooting, many trials in one batch, initial states eliminated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.shooting import ShootingProblem, channel_delays
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes, slopes_at, varying
from deepkoco.fit.solve.lazy_batch import MANY, LazyBatch
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE, Batch
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse
from deepkoco.fit.solve.state_search import search_states
from deepkoco.fit.tangent import Tangent, simulated

__all__ = ["ITERATIONS", "Fit", "FitProblem", "Trial", "channel_delays"]

ITERATIONS = 25  # of a fit at most


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
        iterations: int = ITERATIONS,
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
        return slopes_at(self, tangent, simulated(self, [tangent], nuisance[None]), names)

    def fit_one(
        self,
        trial: Trial,
        iterations: int = ITERATIONS,
        tolerance: float = TOLERANCE,
        known: FrozenSlopes | None = None,
        exact: bool = True,
    ) -> Fit:
        """As :meth:`fit` for one trial, but raises if it diverges.

        Raises:
            DivergedError: The simulation diverges at the start values.
        """
        fit = self.fit([trial], iterations, tolerance, known, exact)[0]
        if fit.diverged:
            raise self.divergence(trial, fit)
        return fit

    def divergence(self, trial: Trial, fit: Fit) -> DivergedError:
        """Return the error that says where a trial diverges.

        Args:
            trial: The trial.
            fit: Its fit, which ended at the start values.
        """
        return DivergedError(
            f"{trial.name}: the simulation of {self.system.base.name} diverges at {self._far_from_nominal(fit)}"
        )

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
        nuisance = self.nuisances.none().repeat(len(state), 1) if nuisance is None else nuisance
        theta = np.array([[float(v[n]) for n in self.names] for v in values])
        return search_states(self, theta, state, nuisance, iterations, TOLERANCE / state.shape[1])

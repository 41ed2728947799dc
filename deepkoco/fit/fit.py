"""Fit trials by Levenberg-Marquardt on multiple shooting: one batch of simulations, initial states eliminated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.per_log_differences import effects_in
from deepkoco.fit.data.windows import Windows, halved
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.simulate.push import Push, push_torque
from deepkoco.fit.simulate.simulator import predict
from deepkoco.fit.solve.encoder_zeros import EncoderZeros
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE, Batch, state_steps
from deepkoco.fit.solve.nuisances import Nuisances
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import NotFiniteError, scaled_inverse
from deepkoco.systems import ExtendedSystem, Parameter

__all__ = ["Fit", "FitProblem", "Trial", "channel_delays"]

SENSING_RANGE = 0.1  # longest delay of one channel [s]


class FitProblem:
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

    def __init__(
        self,
        system: ExtendedSystem,
        windows: Windows,
        late: tuple[str, ...] = (),
        zero_sd: float | None = None,
    ) -> None:
        self.system = system
        self.windows = windows
        self._late, self._zero_sd = late, zero_sd
        delays = channel_delays(late)
        self.late = tuple([c.name for c in system.measurements].index(name) for name in late)
        self.names = tuple(p.name for p in (*system.parameters, *delays)) + Push.NAMES
        declared = {p.name: p for p in (*system.parameters, *delays)} | Push.declared(system, windows)
        self.low = np.array([declared[n].low for n in self.names])
        self.high = np.array([declared[n].high for n in self.names])
        self.scale = np.array([declared[n].prior_sd for n in self.names])
        sd = torch.tensor([n.sd for n in windows.noise], dtype=torch.float64)
        self.weight = windows.valid.to(torch.float64) / sd[None, :, None]
        self.zeros = EncoderZeros.of(system, len(windows.commands), zero_sd)
        self.nuisances = Nuisances(self.zeros, windows.varies)
        self._kept: dict[tuple[str, ...], ExtendedSystem] = {}

    def predict(self, theta: np.ndarray, initial: Tensor, nuisance: Tensor) -> Tensor:
        """Simulate measurements (L, W, N, M) for L lanes of parameters (L, P), states (L, W, S), nuisances (L, z)."""
        nulls = self.null_values()
        rubs = (theta[:, self._dry] != nulls[self._dry]).any(-1)
        if not rubs.any() or rubs.all():
            return self._predict(theta, initial, nuisance)
        # Reversals under dry friction need many more steps, so lanes with and without it are simulated apart.
        result: Tensor | None = None
        for part in (rubs, ~rubs):
            pick = torch.from_numpy(np.flatnonzero(part))
            own = self._predict(theta[part], initial[pick], nuisance[pick])
            result = own.new_empty(len(theta), *own.shape[1:]) if result is None else result
            result[pick] = own
        assert result is not None
        return result

    def _predict(self, theta: np.ndarray, initial: Tensor, nuisance: Tensor) -> Tensor:
        own = len(self.system.parameters)
        nulls = self.null_values()
        values = theta[:, :own].copy()
        for j in self._limits:
            # The null value of a saturation is the command limit. With a gain or a bias, the effort can exceed it.
            values[:, j] = np.where(values[:, j] >= nulls[j], np.inf, values[:, j])
        given = (theta[:, :own] != nulls).T
        lanes: dict[str, slice] = {}
        for effect, columns in self._columns.items():
            acting = np.flatnonzero(given[columns].any(0))
            if len(acting):
                lanes[effect] = slice(int(acting[0]), int(acting[-1]) + 1)
        differing = effects_in((*self.windows.known, self.windows.varies))
        lanes |= {effect: slice(0, len(theta)) for effect in differing}
        # Effects at their null value in every lane would only cost time.
        system = self._extended(tuple(lanes))
        same = (values == values[:1]).all(0)
        named = {
            n: torch.tensor(values[0, j]) if same[j] else torch.from_numpy(np.ascontiguousarray(values[:, j]))
            for j, n in enumerate(self.names[:own])
            if "." not in n or n.split(".")[0] in lanes
        }
        push = push_torque(self.windows, theta[:, -len(Push.NAMES) :], self.system.joints)
        delays = {c: torch.from_numpy(theta[:, own + k]) for k, c in enumerate(self.late)}
        # An effect that acts in all lanes needs no slice.
        some = {effect: part for effect, part in lanes.items() if part.stop - part.start < len(theta)}
        differ = self.nuisances.differ(nuisance)
        result = predict(system, self.windows, named, initial, push, delays, some, differ)
        self.zeros.add(result, nuisance, self.windows.log)
        return result

    def nuisance_slopes(self, parameters: Tensor) -> Tensor:
        """(z, W, N, M) weighted derivatives by the nuisances, from those by the parameters that vary (V, W, N, M)."""
        return self.nuisances.slopes(self.weight, self.windows.log, parameters)

    def values_in(self, fit: Fit, log: int | None = None) -> dict[str, float]:
        """Parameters of one log after a fit; without ``log``, their mean over the logs of these windows."""
        differ = self.nuisances.differ(fit.nuisance[None])
        seen = np.unique(self.windows.log) if log is None else [log]
        values = dict(fit.values)
        for name, own in differ.items():
            j = self.names.index(name)
            # Differences of single logs are not limited by the bounds.
            values[name] = float(np.clip(values[name] + float(own[seen].mean()), self.low[j], self.high[j]))
        return values

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

    def null_values(self) -> np.ndarray:
        """(P,) values at which the effects change nothing; NaN for the parameters of the base system."""
        if not hasattr(self, "_nulls"):
            bare = ExtendedSystem(self.system.base, tuple(e.name for e in self.system.effects))
            self._nulls = np.array([p.value if "." in p.name else np.nan for p in bare.parameters])
            self._limits = [j for j, p in enumerate(bare.parameters) if p.name.endswith(".limit")]
            self._columns: dict[str, list[int]] = {}
            for j, p in enumerate(bare.parameters):
                if "." in p.name:
                    self._columns.setdefault(p.name.split(".")[0], []).append(j)
            finer = bare.base.reversal_steps
            dry = {e.name for e in bare.effects if e.effect.dry and finer[e.index] > 1}
            self._dry = [j for name in self._columns if name in dry for j in self._columns[name]]
        return self._nulls

    def _extended(self, effects: tuple[str, ...]) -> ExtendedSystem:
        """The base system with these effects only. Systems are cached: a fit uses few combinations."""
        if effects not in self._kept:
            self._kept[effects] = ExtendedSystem(self.system.base, effects)
        return self._kept[effects]

    def fit(self, trials: Sequence[Trial], iterations: int = 25, tolerance: float = TOLERANCE) -> list[Fit]:
        """Fit all trials. Every iteration simulates all trials that have not converged in one batch.

        Args:
            trials: What to fit.
            iterations: Largest number of simulations of a trial.
            tolerance: A trial has converged when a step lowers its cost by less.

        Returns:
            One fit per trial; its :attr:`.Fit.diverged` is True if the simulation diverges at the start values.
        """
        return Batch(self, trials, tolerance).run(iterations) if trials else []

    def fit_one(self, trial: Trial, iterations: int = 25, tolerance: float = TOLERANCE) -> Fit:
        """As :meth:`fit` for one trial, but raises if it diverges.

        Raises:
            NotFiniteError: The simulation diverges at the start values.
        """
        fit = self.fit([trial], iterations, tolerance)[0]
        if fit.diverged:
            raise NotFiniteError(
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
        nudge = state_steps(size)
        theta = np.array([[float(v[n]) for n in self.names] for v in values])
        theta = np.tile(theta, (1 + size, 1))
        nuisance = self.nuisances.none().repeat(sets, 1) if nuisance is None else nuisance
        nuisance = nuisance.repeat(1 + size, 1)
        best, trial = state.clone(), state.clone()
        cost = torch.full((sets, count), torch.inf, dtype=torch.float64)
        damping = torch.full((sets, count), 1e-3, dtype=torch.float64)
        hessian = torch.eye(size, dtype=torch.float64).repeat(sets, count, 1, 1)
        gradient = torch.zeros(sets, count, size, dtype=torch.float64)
        differences = torch.tensor(nudge, dtype=torch.float64)[:, None, None, None, None]
        for _ in range(iterations):
            lanes = trial.repeat(1 + size, 1, 1, 1)
            for s in range(size):
                lanes[1 + s, :, :, s] += nudge[s]
            predicted = self.predict(theta, lanes.flatten(0, 1), nuisance).unflatten(0, (1 + size, sets))
            residual = ((self.windows.value - predicted[0]) * self.weight).flatten(2)
            slope = ((predicted[1:] - predicted[0]) / differences * self.weight).flatten(3)
            now = (residual**2).sum(-1)
            curvature = torch.einsum("skwm,tkwm->kwst", slope, slope)
            downhill = torch.einsum("skwm,kwm->kws", slope, residual)
            # The cost can be finite although a lane of the finite differences diverged.
            better = torch.isfinite(now) & torch.isfinite(curvature).flatten(2).all(-1)
            better &= torch.isfinite(downhill).all(-1) & (now <= cost)
            # At the minimum, rounding can make the cost of a step slightly larger than before.
            settled = (cost - now).abs() <= TOLERANCE / count + 1e-4 * now
            hessian = torch.where(better[..., None, None], curvature, hessian)
            gradient = torch.where(better[..., None], downhill, gradient)
            best = torch.where(better[..., None], trial, best)
            cost = torch.where(better, now, cost)
            damping = torch.where(better, damping * 0.1, damping * 20.0).clamp(1e-9, 1e9)
            if bool((settled | (damping > 1e6)).all()):
                break
            diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
            matrix = hessian + torch.diag_embed(damping[..., None] * diagonal + 1e-9)
            step, singular = torch.linalg.solve_ex(matrix, gradient)
            trial = best + torch.where((singular == 0)[..., None], step, 0.0)
        return best, cost


def channel_delays(channels: Sequence[str]) -> tuple[Parameter, ...]:
    """Declare the delay parameter of each of these channels."""
    text = "delay of this channel, state to time stamp of its measurement"
    return tuple(Parameter(f"{c}.delay", 0.0, "s", 0.0, SENSING_RANGE, 0.02, text) for c in channels)

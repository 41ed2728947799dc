"""Levenberg-Marquardt on multiple shooting, many trials in one batch, initial states eliminated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from deepkoco.identify.normal import NormalEquations
from deepkoco.identify.prior import Prior
from deepkoco.identify.push import Push, push_torque
from deepkoco.identify.simulate import predict
from deepkoco.identify.windows import Windows, halved
from deepkoco.systems import ExtendedSystem

TOLERANCE = 0.02  # a fit has converged when a step lowers chi2 by less
STATE_STEP = (1e-6, 1e-5)  # finite differences of the initial angle [rad] and speed [rad/s]
PARAMETER_STEP = 1e-5  # finite difference of a parameter, in its scale
LARGEST_DAMPING = 1e8


@dataclass(frozen=True)
class Trial:
    """One fit to run.

    Attributes:
        name: Name of the trial.
        free: Names of the parameters that it frees, push parameters included.
        prior: Prior over (at least) the free parameters.
        values: Values of all parameters at the start; those not free stay there.
        state: (W, S) initial states at the start; None takes the windows' guess.
        zero: Encoder zeros of the logs at the start [rad]; None for zeros.
    """

    name: str
    free: tuple[str, ...]
    prior: Prior
    values: Mapping[str, float]
    state: Tensor | None = None
    zero: Tensor | None = None


@dataclass
class Fit:
    """Result of one trial.

    Attributes:
        name: Name of the trial.
        free: Names of the freed parameters.
        values: Values of all parameters after the fit.
        covariance: (p, p) posterior covariance of the free parameters under the assumed noise.
        information: (p, p) what the data alone say: the Schur complement of the initial states.
        state: (W, S) initial states.
        zero: (logs,) encoder zeros [rad].
        chi2: Sum of squared residuals in noise standard deviations.
        penalty: Prior's share of the cost.
        residual: (W, N, M) measured minus predicted, in noise standard deviations, 0 where padded.
        history: Cost after every iteration.
        converged: Whether the last step was below the tolerance.
    """

    name: str
    free: tuple[str, ...]
    values: dict[str, float]
    covariance: np.ndarray
    information: np.ndarray
    state: Tensor
    zero: Tensor
    chi2: float
    penalty: float
    residual: Tensor
    history: list[float] = field(default_factory=list)
    converged: bool = False

    @property
    def cost(self) -> float:
        """chi2 plus prior penalty: minus twice the log posterior up to a constant."""
        return self.chi2 + self.penalty


class FitProblem:
    """Windows of measurements of one system, to which trials are fitted.

    The cost of a trial is the squared whitened simulation error over all windows, plus the prior's
    penalty. Initial states of the windows and one encoder zero per log are free in every trial; the
    states are eliminated from the normal equations by their Schur complement, so that the cost of a step
    grows linearly with the number of windows.

    Args:
        system: The extended system; trials choose among its parameters.
        windows: Data.

    Source: Bock, Recent advances in parameter identification (1983) for multiple shooting;
        Nocedal and Wright, Numerical Optimization, ch. 10 for Levenberg-Marquardt.
    """

    def __init__(self, system: ExtendedSystem, windows: Windows) -> None:
        self.system = system
        self.windows = windows
        self.names = tuple(p.name for p in system.parameters) + Push.NAMES
        declared = {p.name: p for p in system.parameters} | Push.declared(system, windows)
        self.low = np.array([declared[n].low for n in self.names])
        self.high = np.array([declared[n].high for n in self.names])
        self.scale = np.array([declared[n].prior_sd for n in self.names])
        sd = torch.tensor([n.sd for n in windows.noise], dtype=torch.float64)
        self.weight = windows.valid.to(torch.float64) / sd[None, :, None]
        zero_sd = [c.zero_sd for c in system.measurements if c.angle]
        self.zero_sd = zero_sd[0] if zero_sd else 0.0
        self.logs = len(windows.commands)

    def predict(self, theta: np.ndarray, initial: Tensor, zero: Tensor) -> Tensor:
        """Measurements (L, W, N, M) of lanes with parameters (L, P), states (L, W, S), zeros (L, logs)."""
        values = torch.from_numpy(self._without_null_limits(theta))
        parameters: dict[str, Tensor] = {}
        active = set()
        for j, name in enumerate(self.names[: len(self.names) - len(Push.NAMES)]):
            column = values[:, j]
            same = bool((column == column[0]).all())
            parameters[name] = column[0] if same else column.contiguous()
            if "." in name and not (same and float(column[0]) in (self._null(name), np.inf)):
                active.add(name.split(".")[0])
        # Effects that no lane uses are left out of the equations: they cost time and change nothing.
        system = ExtendedSystem(self.system.base, tuple(active))
        named = {n: v for n, v in parameters.items() if "." not in n or n.split(".")[0] in active}
        push = push_torque(self.windows, theta[:, -len(Push.NAMES) :])
        result = predict(system, self.windows, named, initial, push)
        if self.zero_sd > 0:
            result[:, :, 0] += zero[:, self.windows.log][..., None]
        return result

    def _without_null_limits(self, theta: np.ndarray) -> np.ndarray:
        """Lift a saturation that is at its null value, the largest command.

        It cuts no command, but in one batch with a gain or a bias it would cut their efforts.
        """
        if "saturation.limit" not in self.names:
            return theta
        column = self.names.index("saturation.limit")
        lifted = theta.copy()
        lifted[:, column] = np.where(theta[:, column] >= self.high[column], np.inf, theta[:, column])
        return lifted

    def _null(self, name: str) -> float:
        if not hasattr(self, "_nulls"):
            bare = ExtendedSystem(self.system.base, tuple(e.name for e in self.system.effects))
            self._nulls = {p.name: p.value for p in bare.parameters}
        return self._nulls[name]

    def fit(self, trials: Sequence[Trial], iterations: int = 25) -> list[Fit]:
        """Run all trials; every iteration simulates all that have not converged in one batch."""
        return _Batch(self, trials).run(iterations) if trials else []

    def evaluate(self, values: Mapping[str, float], name: str = "", state: Tensor | None = None) -> Fit:
        """Fit initial states and zeros only, with every parameter held at ``values``.

        Each window takes the best of three starts: its own guess, the fit of its first half (a short
        window has fewer minima), and ``state`` (W, S), where given.
        """
        halves = FitProblem(self.system, halved(self.windows))
        starts = [self.windows.state, halves.fit_states(values, halves.windows.state)[0][::2]]
        starts += [] if state is None else [state]
        states, costs = self.fit_states_each([values] * len(starts), torch.stack(starts))
        pick = costs.argmin(0)[None, :, None].expand(1, -1, self.windows.state.shape[1])
        first = states.gather(0, pick)[0]
        return self.fit([Trial(name, (), Prior.empty(), values, first)], 12 if self.zero_sd > 0 else 1)[0]

    def fit_states(
        self, values: Mapping[str, float], state: Tensor, iterations: int = 15
    ) -> tuple[Tensor, Tensor]:
        """Initial states (W, S) that suit held parameters, and the cost (W,) that each window keeps."""
        states, costs = self.fit_states_each([values], state[None], iterations)
        return states[0], costs[0]

    def fit_states_each(
        self, values: Sequence[Mapping[str, float]], state: Tensor, iterations: int = 15
    ) -> tuple[Tensor, Tensor]:
        """As :meth:`fit_states` for K sets of parameters and start states (K, W, S) in one batch.

        Windows are independent of each other here, so each one steps and is damped by itself.

        Returns:
            States (K, W, S), costs (K, W).
        """
        sets, count, size = state.shape
        theta = np.array([[float(v[n]) for n in self.names] for v in values])
        theta = np.tile(theta, (1 + size, 1))
        zero = torch.zeros(len(theta), self.logs, dtype=torch.float64)
        best, trial = state.clone(), state.clone()
        cost = torch.full((sets, count), torch.inf, dtype=torch.float64)
        damping = torch.full((sets, count), 1e-3, dtype=torch.float64)
        hessian = torch.eye(size, dtype=torch.float64).repeat(sets, count, 1, 1)
        gradient = torch.zeros(sets, count, size, dtype=torch.float64)
        step = torch.tensor(STATE_STEP[:size], dtype=torch.float64)[:, None, None, None, None]
        for _ in range(iterations):
            lanes = trial.repeat(1 + size, 1, 1, 1)
            for s in range(size):
                lanes[1 + s, :, :, s] += STATE_STEP[s]
            predicted = self.predict(theta, lanes.flatten(0, 1), zero).unflatten(0, (1 + size, sets))
            residual = ((self.windows.value - predicted[0]) * self.weight).flatten(2)
            slope = ((predicted[1:] - predicted[0]) / step * self.weight).flatten(3)
            now = (residual**2).sum(-1)
            better = torch.isfinite(now) & (now <= cost)
            moved = bool((better & (cost - now > TOLERANCE / count)).any())
            curvature = torch.einsum("skwm,tkwm->kwst", slope, slope)
            hessian = torch.where(better[..., None, None], curvature, hessian)
            downhill = torch.einsum("skwm,kwm->kws", slope, residual)
            gradient = torch.where(better[..., None], downhill, gradient)
            best = torch.where(better[..., None], trial, best)
            cost = torch.where(better, now, cost)
            damping = torch.where(better, damping * 0.1, damping * 20.0).clamp(1e-9, 1e9)
            if not moved and bool((better | (damping > 1e6)).all()):
                break
            diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
            matrix = hessian + torch.diag_embed(damping[..., None] * diagonal + 1e-9)
            trial = best + torch.linalg.solve(matrix, gradient)
        return best, cost


class _Batch:
    """State of the trials of one call of :meth:`FitProblem.fit`."""

    def __init__(self, problem: FitProblem, trials: Sequence[Trial]) -> None:
        self.problem, self.trials = problem, trials
        names, windows = problem.names, problem.windows
        self.columns = [np.array([names.index(n) for n in t.free], dtype=int) for t in trials]
        self.width = max((len(c) for c in self.columns), default=0)
        self.theta = np.array([[float(t.values[n]) for n in names] for t in trials])
        self.initial = torch.stack([windows.state if t.state is None else t.state for t in trials]).clone()
        logs = torch.zeros(problem.logs, dtype=torch.float64)
        self.zero = torch.stack([logs if t.zero is None else t.zero for t in trials]).clone()
        self.zeros = problem.logs if problem.zero_sd > 0 else 0
        count = len(trials)
        self.precision = torch.zeros(count, self.width, self.width, dtype=torch.float64)
        self.mean = torch.zeros(count, self.width, dtype=torch.float64)
        for k, t in enumerate(trials):
            p = len(t.free)
            self.precision[k, :p, :p] = torch.from_numpy(t.prior.precision(t.free))
            self.mean[k, :p] = torch.from_numpy(t.prior.mean(t.free))
        self.damping = np.full(count, 1e-4)
        self.cost = np.full(count, np.inf)
        self.done = np.zeros(count, dtype=bool)
        self.converged = np.zeros(count, dtype=bool)
        self.history: list[list[float]] = [[] for _ in trials]
        self.normal: list[NormalEquations | None] = [None] * count

    def run(self, iterations: int) -> list[Fit]:
        trial_theta, trial_initial, trial_zero = self.theta.copy(), self.initial.clone(), self.zero.clone()
        for iteration in range(iterations):
            active = np.flatnonzero(~self.done)
            if len(active) == 0:
                break
            normals = self._linearise(active, trial_theta, trial_initial, trial_zero)
            for k, normal in zip(active, normals, strict=True):
                decrease = self.cost[k] - normal.cost
                if np.isfinite(normal.cost) and decrease >= 0:
                    self.normal[k] = normal
                    self.theta[k], self.cost[k] = trial_theta[k], normal.cost
                    self.initial[k], self.zero[k] = trial_initial[k], trial_zero[k]
                    self.damping[k] = max(self.damping[k] * 0.1, 1e-9)
                    self.converged[k] = decrease < TOLERANCE
                else:
                    self.damping[k] *= 20.0
                    # A step that is refused although the model is exact to rounding has nothing to win.
                    self.converged[k] = np.isfinite(normal.cost) and -decrease < 1e-3 * TOLERANCE
                self.history[k].append(float(self.cost[k]))
                self.done[k] = (
                    self.converged[k] or self.damping[k] > LARGEST_DAMPING or self.normal[k] is None
                )
                if not self.done[k] and iteration < iterations - 1:
                    step = self._step(int(k))
                    trial_theta[k], trial_initial[k], trial_zero[k], gain = step
                    if gain < 0.25 * TOLERANCE:
                        self.done[k] = self.converged[k] = True
        return [self._result(k) for k in range(len(self.trials))]

    def _linearise(
        self, active: np.ndarray, theta: np.ndarray, initial: Tensor, zero: Tensor
    ) -> list[NormalEquations]:
        """Simulate base and perturbed lanes of the active trials at once; form their normal equations."""
        problem = self.problem
        states = initial.shape[-1]
        lane_theta, lane_initial, lane_trial = [], [], []
        steps: list[np.ndarray] = []
        for k in active:
            columns = self.columns[k]
            step = PARAMETER_STEP * problem.scale[columns]
            step = np.where(theta[k, columns] + step > problem.high[columns], -step, step)
            steps.append(step)
            count = 1 + len(columns) + states
            block = np.repeat(theta[k][None], count, axis=0)
            block[1 + np.arange(len(columns)), columns] += step
            start = initial[k][None].repeat(count, 1, 1)
            for s in range(states):
                start[1 + len(columns) + s, :, s] += STATE_STEP[s]
            lane_theta.append(block)
            lane_initial.append(start)
            lane_trial += [k] * count
        predicted = problem.predict(np.concatenate(lane_theta), torch.cat(lane_initial), zero[lane_trial])
        result, at = [], 0
        for i, k in enumerate(active):
            p = len(self.columns[k])
            lanes = predicted[at : at + 1 + p + states]
            at += 1 + p + states
            difference = torch.cat(
                [torch.from_numpy(steps[i]), torch.tensor(STATE_STEP[:states], dtype=torch.float64)]
            )
            slopes = (lanes[1:] - lanes[0]) / difference[:, None, None, None] * problem.weight
            residual = (problem.windows.value - lanes[0]) * problem.weight
            prior = self.precision[k, :p, :p]
            offset = torch.from_numpy(theta[k, self.columns[k]]) - self.mean[k, :p]
            result.append(
                NormalEquations.build(
                    problem.windows,
                    problem.weight,
                    problem.zero_sd,
                    residual,
                    slopes[:p],
                    slopes[p:],
                    prior,
                    offset,
                    zero[k],
                    self.zeros,
                )
            )
        return result

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
            # What leaves the box stops at its bound, and the others are solved again around it.
            outside = ((move[:p] < low) | (move[:p] > high)) & ~held
            if not outside.any():
                break
            held |= outside
            limit = np.where(outside, np.clip(move[:p], low, high), limit)
        theta = self.theta[k].copy()
        theta[columns] = np.clip(at + move[:p], problem.low[columns], problem.high[columns])
        zero = self.zero[k].clone()
        if self.zeros:
            zero += torch.from_numpy(move[p:])
        return theta, self.initial[k] + states, zero, gain

    def _result(self, k: int) -> Fit:
        normal, trial = self.normal[k], self.trials[k]
        if normal is None:
            raise FloatingPointError(f"fit of {trial.name}: the simulation diverges at its start values")
        p = len(self.columns[k])
        full = normal.reduced(0.0)[0].numpy()
        data = full.copy()
        data[:p, :p] -= self.precision[k, :p, :p].numpy()
        covariance = np.linalg.pinv(full, hermitian=True)[:p, :p] if len(full) else full
        return Fit(
            trial.name,
            trial.free,
            dict(zip(self.problem.names, map(float, self.theta[k]), strict=True)),
            covariance,
            data[:p, :p],
            self.initial[k].clone(),
            self.zero[k].clone(),
            normal.chi2,
            normal.cost - normal.chi2,
            normal.residual,
            self.history[k],
            bool(self.converged[k]),
        )

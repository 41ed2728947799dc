"""Methods of a fit. A new method is one class and one line in `METHODS`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch

from deepkoco.fit.data.halves import halved
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.request import FitRequest
from deepkoco.fit.solve.cma import cma_es
from deepkoco.fit.solve.fine_steps import MOST, STEP_ROUNDS, fine_steps, with_steps_cut
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.residual_noise import with_sharp_noise

TOLERANCE = 1e-4  # a user's fit has converged when a step lowers its cost by less
HELD_STEPS = 8  # Gauss-Newton steps of the initial states at fixed parameters
STATE_STEPS = 3  # Gauss-Newton steps of the initial states for each point of a population

Progress = Callable[[str, int, int, float], None]  # stage, iteration, largest number of iterations, cost


@dataclass(frozen=True)
class MethodResult:
    """Result of a method.

    Attributes:
        fit: The optimum with its linearisation.
        request: The request, with the noise that weights the residuals of ``fit``.
        stages: As in :class:`deepkoco.fit.identification.Convergence`.
        simulations: Number of simulations of all windows.
        converged: Whether the method stopped by its tolerance, not at a limit.
        reason: Why it stopped, in words.
    """

    fit: Fit
    request: FitRequest
    stages: tuple[tuple[str, tuple[float, ...]], ...]
    simulations: int
    converged: bool
    reason: str


class Method(Protocol):
    """Solver of a fit."""

    @property
    def name(self) -> str:
        """Name of the method in results."""
        ...

    def solve(self, request: FitRequest, generator: np.random.Generator, progress: Progress) -> MethodResult:
        """Solve a request; all draws come from the generator."""
        ...


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Levenberg-Marquardt on multiple shooting, for smooth costs; needs tens of iterations.

    Attributes:
        iterations: Largest number of iterations of a stage.
    """

    iterations: int = 60
    name: str = "lm"

    def solve(self, request: FitRequest, generator: np.random.Generator, progress: Progress) -> MethodResult:
        stages: list[tuple[str, tuple[float, ...]]] = []
        moved = {*request.free, *request.windows.varies}
        lanes = 1 + len(moved) + request.windows.state.shape[1]

        def run(stage: str, problem: FitProblem, trial: Trial) -> Fit:
            fit = problem.fit_one(trial, self.iterations, TOLERANCE)
            stages.append((stage, tuple(fit.history)))
            progress(stage, len(fit.history), self.iterations, fit.cost)
            return fit

        # The cost of long windows across an unstable equilibrium has many minima; that of half windows has fewer.
        halves = request.problem(halved(request.windows))
        state, _ = halves.fit_states(request.start, halves.windows.state)
        first = run("half windows", halves, _trial(request, request.start, state))
        problem = request.problem()
        state, _ = problem.fit_states(first.values, first.state[::2])
        rough = run("whole windows", problem, _trial(request, first.values, state, first.nuisance))
        windows, last, left = with_sharp_noise(request.windows, rough), rough, MOST
        for stage in ("noise known", *["finer steps"] * (STEP_ROUNDS - 1)):
            parts = fine_steps(request.problem, windows, last, left)
            if parts == 1 and last is not rough:
                break
            windows, left = with_steps_cut(windows, parts), left // parts
            request = replace(request, windows=windows)
            last = run(stage, request.problem(), _trial(request, last.values, last.state, last.nuisance))
        simulations = lanes * sum(len(costs) for _, costs in stages)
        reason = "no step lowers the cost" if last.converged else "limit of iterations"
        return MethodResult(last, request, tuple(stages), simulations, last.converged, reason)


@dataclass(frozen=True)
class CmaEs:
    """CMA-ES over parameters and nuisances of the logs, for costs with many minima or edges.

    Each generation is one batch of simulations. A few Gauss-Newton steps adapt the initial states to each point
    (variable projection). The initial states are therefore no coordinates of the search.

    Attributes:
        population: Points in a generation; None: 4 + 3 ln d.
        generations: Largest number of generations.
    """

    population: int | None = None
    generations: int = 150
    name: str = "cma"

    def solve(self, request: FitRequest, generator: np.random.Generator, progress: Progress) -> MethodResult:
        problem = request.problem()
        spread = _first_spread(request)
        start = np.array([request.start[n] for n in request.free])
        low, high = (np.array([getattr(p, side) for p in request.declared]) for side in ("low", "high"))
        own, free = problem.nuisances.spread, problem.nuisances.count
        objective = _ProfileCost(problem, request)
        search = cma_es(
            objective,
            np.concatenate([start, np.zeros(free)]),
            np.concatenate([spread, own]),
            np.concatenate([low, np.full(free, -np.inf)]),
            np.concatenate([high, np.full(free, np.inf)]),
            generator,
            population=self.population,
            generations=self.generations,
            tolerance=TOLERANCE,
            progress=lambda k, cost: progress("generations", k, self.generations, cost),
        )
        values, nuisance = objective.split(search.best)
        windows = with_sharp_noise(request.windows, self._at(problem, request, values, nuisance))
        request = replace(request, windows=windows)
        fit = self._at(request.problem(), request, values, nuisance)
        stages = (("generations", tuple(search.costs[:, 0].tolist())),)
        return MethodResult(fit, request, stages, objective.simulations, search.converged, search.reason)

    def _at(self, problem: FitProblem, request: FitRequest, values: dict, nuisance: np.ndarray) -> Fit:
        """Fit the initial states at fixed parameters, and linearise there."""
        at = torch.from_numpy(nuisance) if len(nuisance) else None
        both = torch.stack([problem.windows.state])
        state, _ = problem.fit_states_each([values], both, nuisance=None if at is None else at[None])
        return problem.fit_one(_trial(request, values, state[0], at), 1)


METHODS: dict[str, type[LevenbergMarquardt] | type[CmaEs]] = {"lm": LevenbergMarquardt, "cma": CmaEs}


class _ProfileCost:
    """Profile cost: cost of each point of a population, minimised over the initial states of the windows.

    A joint that sticks gives the initial states several minima, so they start from the measured states as well as
    from those of the best point so far.
    """

    def __init__(self, problem: FitProblem, request: FitRequest) -> None:
        self.problem, self.request = problem, request
        self.precision = request.prior.precision(request.free)
        self.centre = request.prior.mean(request.free)
        self.state = problem.fit_states(request.start, problem.windows.state)[0]
        self.lowest = np.inf
        self.simulations = 0

    def split(self, point: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
        count = len(self.request.free)
        return self.request.start | dict(
            zip(self.request.free, map(float, point[:count]), strict=True)
        ), point[count:]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        pairs = [self.split(point) for point in points]
        nuisance = np.array([z for _, z in pairs])
        given = torch.from_numpy(nuisance) if nuisance.shape[1] else None
        starts = torch.stack([self.state, self.problem.windows.state])
        start = starts.repeat_interleave(len(points), 0)
        twice = None if given is None else given.repeat(2, 1)
        states, costs = self.problem.fit_states_each([v for v, _ in pairs] * 2, start, STATE_STEPS, twice)
        states, costs = states.unflatten(0, (2, -1)), costs.unflatten(0, (2, -1))
        better = torch.where(costs.isfinite(), costs, torch.inf).argmin(0)  # (K, W)
        costs = costs.gather(0, better[None])[0]
        states = states.gather(0, better[None, ..., None].expand(-1, -1, -1, states.shape[-1]))[0]
        self.simulations += 2 * STATE_STEPS * len(points) * (1 + self.state.shape[1])
        offset = points[:, : len(self.centre)] - self.centre
        total = costs.sum(-1).numpy() + np.einsum("li,ij,lj->l", offset, self.precision, offset)
        if nuisance.shape[1]:
            total = total + (nuisance**2) @ self.problem.nuisances.precision.numpy()
        k = int(np.nanargmin(np.where(np.isfinite(total), total, np.inf)))
        if total[k] < self.lowest:
            self.lowest, self.state = float(total[k]), states[k]
        return total


def _trial(
    request: FitRequest, values: dict, state: torch.Tensor | None, nuisance: torch.Tensor | None = None
) -> Trial:
    return Trial("fit", request.free, request.prior, values, state, nuisance)


def _first_spread(request: FitRequest) -> np.ndarray:
    """Standard deviations at the start of CMA-ES: the prior's, limited by bounds, value and declared prior."""
    sd = np.sqrt(np.diag(request.prior.covariance))
    index = [request.prior.names.index(n) for n in request.free]
    width = np.array([0.25 * (p.high - p.low) for p in request.declared])
    own = np.array([max(0.3 * abs(p.value), 3.0 * p.prior_sd) for p in request.declared])
    return np.minimum(np.minimum(sd[index], width), own)


def held(request: FitRequest, values: dict[str, float], state: torch.Tensor, nuisance: torch.Tensor) -> Fit:
    """Fit the initial states alone at fixed parameters, to get the simulation errors at these parameters.

    Nuisances start at ``nuisance``, and are fitted too.
    """
    problem = request.problem()
    starts: Sequence[torch.Tensor] = [problem.windows.state, state]
    own = nuisance[None].repeat(2, 1)
    states, costs = problem.fit_states_each([values] * 2, torch.stack(list(starts)), HELD_STEPS, own)
    pick = costs.argmin(0)[None, :, None].expand(1, -1, states.shape[-1])
    trial = Trial("held", (), Prior.empty(), values, states.gather(0, pick)[0], nuisance)
    return problem.fit_one(trial, HELD_STEPS if problem.nuisances.count else 1)

"""How a question is answered: a new method is one class and one line in METHODS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch

from deepkoco.identify.fit import FitProblem
from deepkoco.identify.prior import Prior
from deepkoco.identify.question import Question
from deepkoco.identify.search import cma_es
from deepkoco.identify.sharpen import sharpen_noise
from deepkoco.identify.trial import Fit, Trial
from deepkoco.identify.windows import halved

TOLERANCE = 1e-4  # fall of the cost below which a user's fit has converged
HELD_STEPS = 8  # simulations that suit the initial states to held parameters
STATE_STEPS = 3  # simulations that suit the initial states to one point of a population

Progress = Callable[[str, int, int, float], None]  # stage, iteration, most iterations, cost


@dataclass(frozen=True)
class Answer:
    """What a method found.

    Attributes:
        fit: The optimum, with its linearisation.
        question: The question, with the noise that the fit was weighted by at the end.
        stages: As in :class:`deepkoco.identify.identification.Convergence`.
        simulations: Number of simulations of all windows.
        converged: Whether nothing was left to gain.
        reason: Why it stopped.
    """

    fit: Fit
    question: Question
    stages: tuple[tuple[str, tuple[float, ...]], ...]
    simulations: int
    converged: bool
    reason: str


class Method(Protocol):
    """Answers questions."""

    @property
    def name(self) -> str:
        """Name that results carry."""
        ...

    def answer(self, question: Question, generator: np.random.Generator, progress: Progress) -> Answer:
        """Fit; every draw comes from the generator."""
        ...


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Damped Gauss-Newton on multiple shooting: smooth models, tens of simulations.

    Attributes:
        iterations: Most iterations of a stage.
    """

    iterations: int = 60
    name: str = "lm"

    def answer(self, question: Question, generator: np.random.Generator, progress: Progress) -> Answer:
        stages: list[tuple[str, tuple[float, ...]]] = []
        moved = {*question.free, *question.windows.varies}
        lanes = 1 + len(moved) + question.windows.state.shape[1]

        def run(stage: str, problem: FitProblem, trial: Trial) -> Fit:
            fit = problem.fit_one(trial, self.iterations, TOLERANCE)
            stages.append((stage, tuple(fit.history)))
            progress(stage, len(fit.history), self.iterations, fit.cost)
            return fit

        # A long window across an unstable equilibrium has many minima, the half windows have fewer.
        halves = question.problem(halved(question.windows))
        state, _ = halves.fit_states(question.start, halves.windows.state)
        first = run("half windows", halves, _trial(question, question.start, state))
        problem = question.problem()
        state, _ = problem.fit_states(first.values, first.state[::2])
        rough = run("whole windows", problem, _trial(question, first.values, state, first.nuisance))
        noise = sharpen_noise(question.windows, rough)
        question = replace(question, windows=replace(question.windows, noise=noise))
        last = run(
            "noise known", question.problem(), _trial(question, rough.values, rough.state, rough.nuisance)
        )
        simulations = lanes * sum(len(costs) for _, costs in stages)
        reason = "no step lowers the cost" if last.converged else "limit of iterations"
        return Answer(last, question, tuple(stages), simulations, last.converged, reason)


@dataclass(frozen=True)
class CmaEs:
    """CMA-ES over parameters and nuisances of the logs, a generation in one batch of simulations.

    Initial states of the windows are suited to each point by a few Gauss-Newton steps (variable projection), so
    that the search has as many coordinates as there are parameters. For costs with many minima or edges.

    Attributes:
        population: Points in a generation; None: 4 + 3 ln d.
        generations: Most generations.
    """

    population: int | None = None
    generations: int = 150
    name: str = "cma"

    def answer(self, question: Question, generator: np.random.Generator, progress: Progress) -> Answer:
        problem = question.problem()
        spread = _first_spread(question)
        start = np.array([question.start[n] for n in question.free])
        low, high = (np.array([getattr(p, side) for p in question.declared]) for side in ("low", "high"))
        own, free = problem.nuisances.spread, problem.nuisances.count
        objective = _Profile(problem, question)
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
        noise = sharpen_noise(question.windows, self._at(problem, question, values, nuisance))
        question = replace(question, windows=replace(question.windows, noise=noise))
        fit = self._at(question.problem(), question, values, nuisance)
        stages = (("generations", tuple(search.costs[:, 0].tolist())),)
        return Answer(fit, question, stages, objective.simulations, search.converged, search.reason)

    def _at(self, problem: FitProblem, question: Question, values: dict, nuisance: np.ndarray) -> Fit:
        """The linearised fit at a point: states at their best, parameters where they are."""
        at = torch.from_numpy(nuisance) if len(nuisance) else None
        both = torch.stack([problem.windows.state])
        state, _ = problem.fit_states_each([values], both, nuisance=None if at is None else at[None])
        return problem.fit_one(_trial(question, values, state[0], at), 1)


METHODS: dict[str, type[LevenbergMarquardt] | type[CmaEs]] = {"lm": LevenbergMarquardt, "cma": CmaEs}


class _Profile:
    """Cost of points of a population, minimised over the windows' initial states."""

    def __init__(self, problem: FitProblem, question: Question) -> None:
        self.problem, self.question = problem, question
        self.precision = question.prior.precision(question.free)
        self.centre = question.prior.mean(question.free)
        self.state = problem.fit_states(question.start, problem.windows.state)[0]
        self.lowest = np.inf
        self.simulations = 0

    def split(self, point: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
        count = len(self.question.free)
        return self.question.start | dict(
            zip(self.question.free, map(float, point[:count]), strict=True)
        ), point[count:]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        pairs = [self.split(point) for point in points]
        nuisance = np.array([z for _, z in pairs])
        given = torch.from_numpy(nuisance) if nuisance.shape[1] else None
        start = self.state.expand(len(points), *self.state.shape)
        states, costs = self.problem.fit_states_each([v for v, _ in pairs], start, STATE_STEPS, given)
        self.simulations += STATE_STEPS * len(points) * (1 + self.state.shape[1])
        offset = points[:, : len(self.centre)] - self.centre
        total = costs.sum(-1).numpy() + np.einsum("li,ij,lj->l", offset, self.precision, offset)
        if nuisance.shape[1]:
            total = total + (nuisance**2) @ self.problem.nuisances.precision.numpy()
        k = int(np.nanargmin(np.where(np.isfinite(total), total, np.inf)))
        if total[k] < self.lowest:
            self.lowest, self.state = float(total[k]), states[k]
        return total


def _trial(
    question: Question, values: dict, state: torch.Tensor | None, nuisance: torch.Tensor | None = None
) -> Trial:
    return Trial("fit", question.free, question.prior, values, state, nuisance)


def _first_spread(question: Question) -> np.ndarray:
    """Standard deviations at the start of a search: the prior's, within a quarter of the bounds."""
    sd = np.sqrt(np.diag(question.prior.covariance))
    index = [question.prior.names.index(n) for n in question.free]
    width = np.array([0.25 * (p.high - p.low) for p in question.declared])
    own = np.array([max(0.3 * abs(p.value), 3.0 * p.prior_sd) for p in question.declared])
    return np.minimum(np.minimum(sd[index], width), own)


def held(question: Question, values: dict[str, float], state: torch.Tensor, nuisance: torch.Tensor) -> Fit:
    """Fit of the initial states alone, every parameter held: how well given values explain the windows."""
    problem = question.problem()
    starts: Sequence[torch.Tensor] = [problem.windows.state, state]
    own = nuisance[None].repeat(2, 1)
    states, costs = problem.fit_states_each([values] * 2, torch.stack(list(starts)), HELD_STEPS, own)
    pick = costs.argmin(0)[None, :, None].expand(1, -1, states.shape[-1])
    trial = Trial("held", (), Prior.empty(), values, states.gather(0, pick)[0], nuisance)
    return problem.fit_one(trial, HELD_STEPS if problem.nuisances.count else 1)

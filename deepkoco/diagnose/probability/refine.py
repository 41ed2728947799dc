"""Refit of explanations: the most probable parameters of the simulation, with the model error in the likelihood.

All explanations are refitted together, with one batch of simulations for each step. A step is that of Levenberg and
Marquardt in the metric of the model error. The little that any unit has of the effects that are not freed stays linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose.evidence.priors import declared
from deepkoco.diagnose.probability.coordinates import Catalogue, is_shape
from deepkoco.diagnose.probability.explanations import Explanation
from deepkoco.diagnose.probability.gram import KeptColumns, UnitLoads, WindowSums, misfit
from deepkoco.diagnose.probability.normal import Normal
from deepkoco.diagnose.probability.unit import UnitPrior
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.levenberg_marquardt import LARGE
from deepkoco.fit.tangent import Tangent, simulated

STEPS = 25
STATIONARY = 0.1  # predicted fall of -2 log posterior at which a point is stationary
HARDEST = 1e8  # damping from which a refit stops


@dataclass(frozen=True)
class Fixed:
    """What all refits share, from the linearisation at one point.

    Attributes:
        catalogue: Coordinates.
        origin: The point.
        linear: (W, n, l) columns that stay as they are there: tolerated changes, weights of the smooth function, zeros.
        responses: (W, n, m) of independent unit loads in time.
        unit: Prior of base parameters, tolerated changes, weights and zeros.
        tolerated: Numbers of the coordinates of the tolerated changes, in the order of the linear columns.
        share: What any unit has of an effect without a slope, in Cauchy scales.
    """

    catalogue: Catalogue
    origin: Fit
    linear: np.ndarray
    responses: np.ndarray
    unit: UnitPrior
    tolerated: np.ndarray
    share: float

    @cached_property
    def places(self) -> dict[int, int]:
        """Place in the prior of any unit of each coordinate that it has."""
        own = len(self.catalogue.base)
        return {c: c for c in range(own)} | {int(c): own + k for k, c in enumerate(self.tolerated)}

    @property
    def here(self) -> np.ndarray:
        """Values of base parameters, tolerated changes, weights and zeros at the point."""
        own, zeros = [self.origin.values[n] for n in self.catalogue.base], self.origin.nuisance.numpy()
        return np.concatenate([own, np.zeros(self.linear.shape[2] - len(zeros)), zeros])

    @cached_property
    def loads(self) -> UnitLoads:
        """The responses, for the products of every refit."""
        return UnitLoads.of(self.responses)

    @cached_property
    def kept(self) -> KeptColumns:
        """The linear columns with their products, for every refit."""
        return KeptColumns.of(self.linear, self.loads)

    @cached_property
    def priors(self) -> dict[int, Normal]:
        """The prior under each size of the model error that was asked for."""
        return {}

    def prior(self, amplitude: int) -> Normal:
        """Return the prior under a size of the model error, by its number."""
        if amplitude not in self.priors:
            self.priors[amplitude] = self.unit.normal(amplitude)
        return self.priors[amplitude]


@dataclass
class Refit:
    """One explanation under refinement.

    Attributes:
        explanation: The explanation.
        amplitude: Number of the size of the model error.
        names: Parameter of each nonlinear coordinate: base parameters, freed changes, shapes.
        value: (v,) of the nonlinear coordinates; differences from the origin for base parameters, changes, shapes.
        weights: (l,) of the linear columns.
        state: (W, S) initial states.
        stationary: Whether the last step promised less than `STATIONARY`.
        cost: -2 log posterior up to a constant.
        damping: Of the next step.
        done: Whether no further step is tried.
        sums: Products of all columns at the last point: nonlinear ones, then linear ones. None before the first step.
    """

    explanation: Explanation
    amplitude: int
    names: tuple[str, ...]
    value: np.ndarray
    weights: np.ndarray
    state: Tensor
    stationary: bool = False
    cost: float = np.inf
    damping: float = 1e-3
    done: bool = False
    sums: WindowSums | None = None

    @property
    def own(self) -> int:
        """Number of base parameters."""
        return len(self.names) - len(self.explanation.columns) - len(shapes_of(self.explanation))


def started(fixed: Fixed, explanation: Explanation, mode: np.ndarray, amplitude: int) -> Refit:
    """Return a refit that starts at the origin with the changes of a linearised search.

    Args:
        fixed: What all refits share.
        explanation: The explanation.
        mode: Values of its changes, in the order of its columns.
        amplitude: Number of the size of the model error.
    """
    coordinates = [fixed.catalogue.coordinates[c] for c in explanation.columns]
    shapes = shapes_of(explanation)
    names = (*fixed.catalogue.base, *(c.parameter for c in coordinates), *shapes)
    at = np.clip(mode, [c.low for c in coordinates], [c.high for c in coordinates])
    value = np.concatenate([np.zeros(len(fixed.catalogue.base)), at, list(shapes.values())])
    weights = np.zeros(fixed.linear.shape[2])
    return Refit(explanation, amplitude, names, value, weights, fixed.origin.state.clone())


def widened(fixed: Fixed, plain: Refit, explanation: Explanation) -> Refit:
    """Return a refit of an explanation that starts at the optimum of "nothing", with its changes at null.

    Args:
        fixed: What all refits share.
        plain: The refit of "nothing".
        explanation: The explanation.
    """
    own = len(fixed.catalogue.base)
    wider = started(fixed, explanation, np.zeros(len(explanation.columns)), plain.amplitude)
    wider.value[:own] = plain.value[:own]
    return replace(wider, weights=plain.weights.copy(), state=plain.state.clone())


def shapes_of(explanation: Explanation) -> dict[str, float]:
    """Return the shapes that a fit frees, with their values at the starts."""
    return {
        n: item.start[n]
        for item in explanation.items
        for n in item.cause.free
        if is_shape(n) and n in item.start
    }


def theta_of(problem: FitProblem, fixed: Fixed, refit: Refit, value: np.ndarray) -> np.ndarray:
    """Return the vector of all parameters (P,) of a refit at nonlinear coordinates (v,)."""
    theta = np.array([fixed.origin.values[n] for n in problem.names])
    for item in refit.explanation.items:
        for name, v in item.start.items():
            if is_shape(name):
                theta[problem.names.index(name)] = v
    shaped = len(shapes_of(refit.explanation))
    plain = len(value) - shaped
    for name, v in zip(refit.names[:plain], value[:plain], strict=True):
        theta[problem.names.index(name)] += v
    for name, v in zip(refit.names[plain:], value[plain:], strict=True):
        theta[problem.names.index(name)] = v
    return np.clip(theta, problem.low, problem.high)


def refined(problem: FitProblem, fixed: Fixed, refits: Sequence[Refit], steps: int = STEPS) -> list[Refit]:
    """Run all refits until each is stationary or cannot go on.

    Args:
        problem: The windows.
        fixed: What all refits share.
        refits: Their starts.
        steps: Largest number of simulations of each.
    """
    refits = [replace(r) for r in refits]
    trials = [(r.value, r.weights, r.state) for r in refits]
    systems: list[_Equations | None] = [None] * len(refits)
    for _ in range(steps):
        active = [k for k, r in enumerate(refits) if not r.done]
        if not active:
            break
        for k, equations in zip(
            active,
            _linearised(problem, fixed, [refits[k] for k in active], [trials[k] for k in active]),
            strict=True,
        ):
            refit = refits[k]
            if equations is not None and equations.cost <= refit.cost:
                systems[k] = equations
                refit.cost, refit.sums = equations.cost, equations.sums
                refit.value, refit.weights, refit.state = trials[k]
                refit.damping = max(0.1 * refit.damping, 1e-9)
            else:
                refit.damping *= 20.0
            kept = systems[k]
            if kept is None or refit.damping > HARDEST:
                refit.done = True
                continue
            move, weights, states, promise = kept.step(refit.damping, *_room(problem, fixed, refit))
            if promise < STATIONARY:
                refit.stationary = refit.done = True
                continue
            trials[k] = (refit.value + move, refit.weights + weights, refit.state + torch.from_numpy(states))
    return refits


def _room(problem: FitProblem, fixed: Fixed, refit: Refit) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much each nonlinear coordinate may fall and rise."""
    theta = theta_of(problem, fixed, refit, refit.value)
    index = [problem.names.index(n) for n in refit.names]
    return problem.low[index] - theta[index], problem.high[index] - theta[index]


@dataclass
class _Equations:
    """Normal equations of one refit at one point."""

    products: np.ndarray  # (W, z + 1 + S, ...): coordinates z, residual, states
    precision: np.ndarray  # (z, z) of the prior
    offset: np.ndarray  # (z,) value minus the prior's mean
    cost: float
    nonlinear: int
    sums: WindowSums

    def step(
        self, damping: float, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        z, v = len(self.offset), self.nonlinear
        hss = self.products[:, z + 1 :, z + 1 :]
        diagonal = np.einsum("wss->ws", hss)
        blocks = hss + (damping * diagonal + 1e-9)[:, :, None] * np.eye(hss.shape[1])
        hps, gs = self.products[:, :z, z + 1 :], self.products[:, z, z + 1 :]
        through = np.linalg.solve(blocks, hps.transpose(0, 2, 1))  # (W, S, z)
        solved = np.linalg.solve(blocks, gs[..., None])[..., 0]
        hpp = self.products[:, :z, :z].sum(0) + self.precision
        gp = self.products[:, :z, z].sum(0) - self.precision @ self.offset
        matrix = hpp - np.einsum("wis,wsj->ij", hps, through)
        matrix[np.arange(v), np.arange(v)] += damping * np.diag(hpp)[:v]
        right = gp - np.einsum("wis,ws->i", hps, solved)
        held, move = np.zeros(z, dtype=bool), np.zeros(z)
        for _ in range(v + 1):
            free = ~held
            scale = 1.0 / np.sqrt(np.diag(matrix)[free])
            scaled = matrix[np.ix_(free, free)] * scale[:, None] * scale
            wanted = (right - matrix[:, held] @ move[held])[free] * scale
            move[free] = np.linalg.lstsq(scaled, wanted, rcond=1e-13)[0] * scale
            out = ((move[:v] < low - 1e-12) | (move[:v] > high + 1e-12)) & ~held[:v]
            if not out.any():
                break
            move[:v] = np.where(out, np.clip(move[:v], low, high), move[:v])
            held[:v] |= out
        states = np.einsum("wst,wt->ws", np.linalg.inv(blocks), gs - np.einsum("wis,i->ws", hps, move))
        curved = move @ hpp @ move + np.einsum("ws,wst,wt->", states, hss, states)
        curved += 2.0 * np.einsum("i,wis,ws->", move, hps, states)
        promise = 2.0 * (gp @ move + (gs * states).sum()) - curved
        return move[:v], move[v:], states, float(promise)


def _linearised(problem, fixed, refits, trials) -> list[_Equations | None]:
    """Return the equations of refits at their next points; None where a point is no better than the last one."""
    raised = _raised(problem, fixed, refits, trials)
    going_on = [k for k in range(len(refits)) if k not in raised]
    found: list[_Equations | None] = [None] * len(refits)
    own = ([given[k] for k in going_on] for given in (refits, trials))
    for k, equations in zip(going_on, _with_slopes(problem, fixed, *own) if going_on else (), strict=True):
        found[k] = equations
    return found


def _raised(problem, fixed, refits, trials) -> set[int]:
    """Return the refits whose next points raise their costs, for which no slopes are needed.

    About every second step is rejected. Small problems simulate points and slopes at once.
    """
    later = [k for k, refit in enumerate(refits) if refit.sums is not None]
    lanes = sum(1 + len(refits[k].names) + refits[k].state.shape[1] for k in later)
    if not later or lanes < LARGE * problem.most_lanes:
        return set()
    theta = np.stack([theta_of(problem, fixed, refits[k], trials[k][0]) for k in later])
    states = torch.stack([trials[k][2] for k in later])
    predicted = problem.predict(theta, states, fixed.origin.nuisance[None].repeat(len(later), 1))
    windows, raised = len(problem.windows), set()
    for k, own in zip(later, predicted, strict=True):
        refit, (value, weights, _) = refits[k], trials[k]
        residual = problem.weighed(problem.windows.value - own).reshape(windows, -1).numpy()
        residual = residual - fixed.linear @ weights
        left = misfit(fixed.loads, residual, _amplitude(fixed, refit))
        cost = left + _prior(problem, fixed, refit, value, weights)[2]
        if not cost <= refit.cost:
            raised.add(k)
    return raised


def _amplitude(fixed: Fixed, refit: Refit) -> float:
    return float(fixed.unit.amplitudes.in_time[refit.amplitude])


def _with_slopes(problem, fixed, refits, trials) -> list[_Equations | None]:
    tangents, lanes = [], []
    for refit, (value, _, state) in zip(refits, trials, strict=True):
        theta = theta_of(problem, fixed, refit, value)
        # A base parameter and its change move the same parameter.
        columns = np.array([problem.names.index(n) for n in dict.fromkeys(refit.names)], dtype=int)
        tangents.append(Tangent.at(problem, theta, columns, state))
        lanes.append(len(tangents[-1]))
    predicted = simulated(problem, tangents, fixed.origin.nuisance[None].repeat(len(tangents), 1))
    found, at = [], 0
    for refit, (value, weights, _), tangent, count in zip(refits, trials, tangents, lanes, strict=True):
        own = predicted[at : at + count]
        at += count
        found.append(_equations(problem, fixed, refit, value, weights, tangent, own))
    return found


def _equations(problem, fixed, refit, value, weights, tangent, predicted) -> _Equations | None:
    windows = len(problem.windows)
    slopes = tangent.slopes(predicted, problem).reshape(len(tangent) - 1, windows, -1)
    residual = problem.weighed(problem.windows.value - predicted[0]).reshape(windows, -1)
    if not (torch.isfinite(slopes).all() and torch.isfinite(residual).all()):
        return None
    slopes, residual = slopes.permute(1, 2, 0).numpy(), residual.numpy() - fixed.linear @ weights
    distinct = list(dict.fromkeys(refit.names))
    columns = slopes[:, :, [distinct.index(n) for n in refit.names]]
    sums = fixed.kept.beside(columns, slopes[:, :, len(distinct) :], residual)
    precision, offset, penalty = _prior(problem, fixed, refit, value, weights)
    products = sums.products(_amplitude(fixed, refit))
    z = sums.coordinates
    cost = float(products[:, z, z].sum()) + penalty
    return _Equations(products, precision, offset, cost, len(value), sums) if np.isfinite(cost) else None


def _prior(problem, fixed, refit, value, weights) -> tuple[np.ndarray, np.ndarray, float]:
    """Return precision, offset and -2 log density of the prior at a point."""
    own, freed = len(fixed.catalogue.base), len(refit.explanation.columns)
    v = len(value)
    z = v + len(weights)
    precision, offset = np.zeros((z, z)), np.zeros(z)
    shared = np.concatenate([np.arange(own), v + np.arange(len(weights))])
    healthy = fixed.prior(refit.amplitude)
    precision[np.ix_(shared, shared)] = healthy.precision
    offset[shared] = np.concatenate([value[:own], weights]) + fixed.here - healthy.mean
    shapes = shapes_of(refit.explanation)
    sd = np.array([p.prior_sd for p in declared(problem, list(shapes))])
    place = own + freed + np.arange(len(shapes))
    precision[place, place] = sd**-2.0
    offset[place] = value[place] - np.array(list(shapes.values()))
    penalty = float(offset @ precision @ offset)
    # -2 log of a Cauchy density is 2 log(1 + d^2 / w^2); its slope is that of a normal of precision 2 / (w^2 + d^2).
    change = own + np.arange(freed)
    wide = np.array([fixed.catalogue.coordinates[c].wide for c in refit.explanation.columns])
    offset[change] = value[change]
    precision[change, change] = 2.0 / (wide**2 + value[change] ** 2)
    penalty += float(2.0 * np.log1p((value[change] / wide) ** 2).sum())
    return precision, offset, penalty

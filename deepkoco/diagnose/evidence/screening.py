"""Score test: the fall of the cost that each cause promises to first order, from one batch of simulations.

A full fit of every cause needs many simulations, and most causes explain nothing. The score test simulates one small
dose of each cause. The dose moves the measurements in some direction. The baseline's parameters and the windows'
initial states are projected out of it. The residuals along the rest of this direction give the fall of chi2 that the
linearised fit would reach.

Source: the score test; Rao, Linear Statistical Inference and its Applications, 6e.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.causes.parameter import widened
from deepkoco.diagnose.residuals.residuals import waves_of
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes
from deepkoco.fit.solve.normal_equations import NormalEquations
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import scaled_inverse
from deepkoco.fit.tangent import Tangent, parameter_step, simulated

LANES = 160  # simulations in one batch
RIDGE = 1e-8  # relative; two doses may move the measurements in the same direction
# Relative, of the parameters; the first one with which a dose keeps what it is. Healthy logs tell some combinations a
# million times better than others, and what rounding leaves of the curvature may take more out of a dose than it has.
RIDGES = (0.0, 1e-10, 1e-8, 1e-6, 1e-4)
WORTH = 8.0  # promised fall of the cost from which a cause is fitted
NEARLY = 0.9  # of a promise by slopes, from which the start that keeps the motion is the better one
SAME = 1e-2  # relative difference of two responses up to which they are one quantity


class StartPoint(NamedTuple):
    """One start of a cause, and the fall of the cost that the score test predicts (the promise)."""

    cause: Cause
    values: Mapping[str, float]
    promise: float


def screen(
    problem: FitProblem,
    reference: Fit,
    prior: Prior,
    starts: Sequence[tuple[Cause, Mapping[str, float]]],
    tangent: Linearised | None = None,
) -> list[StartPoint]:
    """Return the promise of every start on top of a reference fit; ``tangent`` is its linearisation, if known.

    A start at null is tested along the slopes of its free parameters. A start away from null is tested along the
    secant from null to the start, because some effects have zero slope at null. A changed parameter of the system
    needs no simulation: the linearised problem contains it, and only its prior becomes wider. It is left out where
    another cause adds to the same quantity what it needs.
    """
    tangent = Linearised(problem, reference, prior) if tangent is None else tangent
    free = set(reference.free)
    changed = [pair for pair in starts if is_changed(pair[0]) and free.issuperset(pair[0].free)]
    starts = [pair for pair in starts if not (is_changed(pair[0]) and free.issuperset(pair[0].free))]
    doses, owner, forward = [], [], []
    for k, (cause, place) in enumerate(starts):
        own = _doses(problem, reference, cause, place)
        doses += own
        owner += [k] * len(own)
        forward.append(len(own) == 1 and _one_way(problem, reference, cause, place))
    moved = tangent.respond(doses)
    _along_what_is_shown(problem, reference, moved, doses, [starts[k][0] for k in owner])
    promises = tangent.promises(moved, np.array(owner, dtype=int), forward)
    points = [StartPoint(c, place, float(p)) for (c, place), p in zip(starts, promises, strict=True)]
    lasting = [d for d in range(len(doses)) if starts[owner[d]][0].effect != "event"]
    single = {d: name for d in lasting if (name := _only_change(reference, doses[d]))}
    for cause, place in changed:
        (name,) = cause.free
        slope, promise = tangent.slope_of(name), tangent.promise_of_change(name, prior)
        # Both respond to 1 unit alike, as an addition to the friction does to friction itself.
        unit = problem.system.parameter(name).unit
        taken_over = {
            d: _taken_over(problem, reference, prior, name, own)
            for d, own in single.items()
            if problem.system.parameter(own).unit == unit
            and _same_response(moved[d], doses[d][own] - reference.values[own], slope)
        }
        # A payload has the response of its body's mass, but no body gets lighter by one.
        given = float(prior.mean([name])[0])
        away = abs(reference.values[name] - given)
        enough = [
            abs(taken[name] - given) <= (1.0 - NEARLY) * away
            if taken
            else points[owner[d]].promise >= NEARLY * promise
            for d, taken in taken_over.items()
        ]
        if not any(enough):
            points.append(StartPoint(cause, place, promise))
        for d, taken in taken_over.items():
            rival = points[owner[d]]
            start = StartPoint(rival.cause, {**rival.values, **taken}, promise)
            if taken and promise > NEARLY * rival.promise:
                points[owner[d]] = start
            elif taken and promise >= WORTH:
                # Slopes of the two that differ a little promise more than there is, and no step along them is one.
                points.append(start)
    return points


def _along_what_is_shown(
    problem: FitProblem,
    reference: Fit,
    moved: Tensor,
    doses: Sequence[Mapping[str, float]],
    causes: Sequence[Cause],
) -> None:
    """Put into ``moved`` (D, W, NM) the responses to loads that repeat along the way of a slide, along its shown way.

    Where such a load is missing, the simulation is off by a part of its pitch or more, and what the load does on the
    simulated way says nothing of what it did on the machine.
    """
    for joint in sorted({c.joint for c in causes if c.kind == "cogging" and c.joint is not None}):
        own = [d for d, c in enumerate(causes) if c.kind == "cogging" and c.joint == joint]
        own = [d for d in own if f"{causes[d].effect}.pitch" in doses[d]]
        if own:
            waves = waves_of(problem, reference, joint)
            sizes = [[doses[d][f"{causes[d].effect}.{n}"] for n in ("pitch", "sine", "cosine")] for d in own]
            null = [reference.values[f"{causes[own[0]].effect}.{n}"] for n in ("pitch", "sine", "cosine")]
            moved[own] = waves.responses(np.array(sizes), np.array(null))


def _only_change(reference: Fit, dose: Mapping[str, float]) -> str:
    """Return the parameter that a dose moves; empty where it moves several."""
    moved = [n for n, v in dose.items() if v != reference.values[n]]
    return moved[0] if len(moved) == 1 else ""


def _same_response(moved: Tensor, amount: float, slope: Tensor) -> bool:
    """Return whether a dose of this amount moves the measurements as along a slope."""
    return bool((moved.reshape(-1) / amount - slope).norm() <= SAME * slope.norm())


def _taken_over(problem: FitProblem, reference: Fit, prior: Prior, name: str, own: str) -> dict[str, float]:
    """Return values with which an effect adds what the refit has moved a parameter by; none where it cannot.

    The motion stays the same, and the parameter is back at its prior. Slopes do not lead there: where a log tells much
    of the sum of both, the finite differences of the two are not equal enough.

    Args:
        problem: Bounds of the parameters.
        reference: The refit.
        prior: Prior of its parameters.
        name: The parameter.
        own: The effect's parameter that does the same.
    """
    j, given = problem.names.index(own), float(prior.mean([name])[0])
    moved = float(
        np.clip(reference.values[own] + reference.values[name] - given, problem.low[j], problem.high[j])
    )
    amount = moved - reference.values[own]
    return {} if amount == 0.0 else {own: moved, name: reference.values[name] - amount}


def _doses(
    problem: FitProblem, reference: Fit, cause: Cause, place: Mapping[str, float]
) -> list[dict[str, float]]:
    """Return parameter values; each moves the measurements in one of the directions of the cause."""
    at = {**reference.values, **place}
    null = reference.values
    shifted = any(at[n] != null[n] for n in place if n not in Push.NAMES or n in Push.SIZES)
    silent = shifted and not _linear(cause, place)
    result = [at] if silent else []
    if cause.effect == "event":
        return [at]
    for name in cause.free:
        j = problem.names.index(name)
        if silent and name in place:
            continue
        step = parameter_step(reference.state.shape[1]) * problem.scale[j]
        if name.endswith((".frequency", ".pitch")):
            continue  # it changes nothing while the amplitude is zero
        if name.endswith(".along") and not silent:
            continue  # nor does the place of no load; other starts are other places
        if name.endswith(".centre"):
            # It changes nothing while the stiffness is zero. A stiffness about another centre is the second direction.
            result.append({**result[-1], name: at[name] + problem.scale[j]})
            continue
        step = -step if at[name] + step > problem.high[j] else step
        result.append({**at, name: at[name] + step})
    return result


def _one_way(problem: FitProblem, reference: Fit, cause: Cause, place: Mapping[str, float]) -> bool:
    """Return whether the only dose may have positive sign only: away from null, or from a bound."""
    if any(reference.values[n] != v for n, v in place.items()):
        return True
    return any(reference.values[n] <= problem.low[problem.names.index(n)] for n in cause.free)


def _linear(cause: Cause, place: Mapping[str, float]) -> bool:
    """Return whether a start only chooses a shape (a frequency, a Stribeck speed) and leaves the size at null."""
    if cause.kind == "payload":
        return not any(value for name, value in place.items() if name.endswith(".mass"))
    return cause.kind in ("cogging", "periodic", "spring", "sensor_ripple") or (
        cause.kind == "stribeck" and len(place) == 1
    )


class Linearised:
    """Measurements linearised in the baseline's parameters and the windows' initial states at a reference."""

    def __init__(self, problem: FitProblem, reference: Fit, prior: Prior) -> None:
        self.problem, self.reference = problem, reference
        free = list(reference.free)
        theta = np.array([reference.values[n] for n in problem.names])
        also = [n for n in problem.nuisances.varies if n not in free]
        columns = np.array([problem.names.index(n) for n in (*free, *also)], dtype=int)
        tangent = Tangent.at(problem, theta, columns, reference.state)
        predicted = simulated(problem, [tangent], reference.nuisance[None])
        slopes = tangent.slopes(predicted, problem)
        precision, offset = map(torch.from_numpy, prior.penalty(free).at(theta[columns[: len(free)]]))
        self.residual = problem.weighed(problem.windows.value - predicted[0])
        p, self.states = len(free), slopes[len(columns) :]
        own = problem.nuisance_slopes(slopes[[(*free, *also).index(n) for n in problem.nuisances.varies]])
        self.normal = NormalEquations.build(
            self.residual,
            slopes[:p],
            self.states,
            own,
            precision,
            offset,
            reference.nuisance,
            problem.nuisances.precision,
        )
        self.slopes = torch.cat([slopes[:p], own])

    def kept(self) -> FrozenSlopes:
        """Return the slopes, for fits that start at the reference."""
        return FrozenSlopes.of(self.reference.free, self.slopes, self.states)

    def slope_of(self, name: str) -> Tensor:
        """Return the whitened derivative (W * NM,) of the measurements by a free parameter."""
        return self.slopes[self.reference.free.index(name)].reshape(-1)

    def promise_of_change(self, name: str, prior: Prior) -> float:
        """Return the fall of the cost if one of the baseline's parameters has a wide prior.

        With the curvature M, the gradient r and the offset o from the prior P, another prior P' gives
        M' = M - P + P' and r' = r + (P - P') o. The cost then falls by o'(P - P')o + r'' M'^-1 r' - r' M^-1 r.
        """
        free = self.reference.free
        wide = prior.widened([widened(self.problem.system.parameter(name))], self.reference.values)
        values = np.array([self.reference.values[n] for n in free])
        own, offset = map(torch.from_numpy, prior.penalty(free).at(values))
        narrow = own - torch.from_numpy(wide.penalty(free).at(values)[0])
        matrix, right, _ = self.normal.reduced(0.0)
        p, falls = len(free), []
        for relief in (torch.zeros_like(narrow), narrow):
            curvature, gradient = matrix.clone(), right.clone()
            curvature[:p, :p] -= relief
            gradient[:p] += relief @ offset
            solved = torch.from_numpy(scaled_inverse(curvature.numpy()))
            falls.append(float(offset @ relief @ offset + gradient @ (solved @ gradient)))
        promise = falls[1] - falls[0]
        return promise if np.isfinite(promise) else 0.0

    def respond(self, doses: Sequence[Mapping[str, float]]) -> Tensor:
        """Return the whitened change (D, W, NM) of the measurements by each dose."""
        problem, reference = self.problem, self.reference
        theta = np.array([[d[n] for n in problem.names] for d in doses]).reshape(-1, len(problem.names))
        null = np.array([[reference.values[n] for n in problem.names]])
        parts = []
        for at in range(0, len(theta), LANES):
            chunk = np.concatenate([null, theta[at : at + LANES]])
            states = reference.state[None].expand(len(chunk), -1, -1)
            nuisance = reference.nuisance[None].expand(len(chunk), -1)
            predicted = problem.with_usual_steps.predict(chunk, states, nuisance)
            change = problem.weighed(predicted[1:] - predicted[0])
            parts.append(change.reshape(len(chunk) - 1, len(problem.windows), -1))
        return torch.cat(parts) if parts else torch.zeros(0, len(problem.windows), 1, dtype=torch.float64)

    def promises(self, moved: Tensor, owner: np.ndarray, forward: Sequence[bool]) -> np.ndarray:
        """Return the fall of the cost by the doses of each owner together with the baseline's parameters."""
        windows = len(self.problem.windows)
        residual = self.residual.reshape(windows, -1)
        states = self.states.reshape(len(self.states), windows, -1)
        slopes = self.slopes.reshape(len(self.slopes), windows, -1)
        matrix, right, inverse = self.normal.reduced(0.0)
        # Project the initial states of each window out of the doses.
        along = torch.einsum("dwm,swm->wds", moved, states)
        through = along @ inverse
        both = torch.einsum("dwm,pwm->dp", moved, slopes) - torch.einsum(
            "wds,wps->dp", through, self.normal.hps
        )
        pull = torch.einsum("dwm,wm->d", moved, residual) - torch.einsum("wds,ws->d", through, self.normal.gs)
        # Then project the baseline's parameters out.
        parameters = Curvature(matrix, right)
        result = np.zeros(len(forward))
        for k in range(len(forward)):
            own = np.flatnonzero(owner == k)
            if len(own) == 0:
                continue
            pick = torch.as_tensor(own)
            gram = torch.einsum("dwm,ewm->de", moved[pick], moved[pick])
            gram = gram - torch.einsum("wds,wes->de", through[:, pick], along[:, pick])
            gram, rest = parameters.without(gram, both[pick], pull[pick])
            if not (forward[k] and float(rest[0]) < 0.0):
                result[k] = _gain(gram.numpy(), rest.numpy())
        return result


class Curvature:
    """Curvature of the cost by the baseline's parameters, and what is left of doses beside them.

    Args:
        matrix: (P, P) curvature, without the initial states.
        right: (P,) slope.
    """

    def __init__(self, matrix: Tensor, right: Tensor) -> None:
        self.matrix, self.right = matrix, right
        self._inverses: dict[float, Tensor] = {}

    def without(self, gram: Tensor, both: Tensor, pull: Tensor) -> tuple[Tensor, Tensor]:
        """Return the curvature (D, D) by doses and their pull (D,), with the parameters projected out.

        Args:
            gram: Curvature (D, D) by the doses with the parameters held.
            both: Mixed curvature (D, P).
            pull: Slope (D,) by the doses with the parameters held.
        """
        rest, left = gram, pull
        for ridge in RIDGES:
            if ridge not in self._inverses:
                self._inverses[ridge] = torch.from_numpy(scaled_inverse(self.matrix.numpy(), ridge))
            solved = self._inverses[ridge]
            rest, left = gram - both @ solved @ both.T, pull - both @ (solved @ self.right)
            if bool((rest.diagonal() >= 0.0).all()):
                break
        return rest, left


def _gain(gram: np.ndarray, pull: np.ndarray) -> float:
    size = np.sqrt(np.clip(np.diag(gram), 1e-300, None))
    scaled = gram / np.outer(size, size) + RIDGE * np.eye(len(gram))
    wanted = pull / size
    if not (np.isfinite(scaled).all() and np.isfinite(wanted).all()):
        return 0.0
    return float(wanted @ np.linalg.lstsq(scaled, wanted, rcond=None)[0])

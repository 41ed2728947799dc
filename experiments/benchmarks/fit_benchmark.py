"""Fit of `deepkoco.fit` against `scipy.optimize.least_squares` on the same residuals.

python -m experiments.benchmarks.fit_benchmark [--seconds 21] [--repeats 3] [--json]

Both start at the same parameters and initial states and minimise the same function. SciPy runs twice: with finite
differences under the Jacobian's sparsity pattern (what its documentation advises), and with a Jacobian from the same
batch of simulations that the fit uses. Times are of the process, medians over repeats, in turn, in one run.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import least_squares

from deepkoco.excitation.record import record
from deepkoco.fit.fit_types import Trial
from deepkoco.fit.request import FitRequest, make_request
from deepkoco.fit.solve.methods import TOLERANCE
from deepkoco.fit.tangent import PARAMETER_STEP
from deepkoco.fit.threads import one_thread
from deepkoco.unit.unit_file import make_unit

ASKED = ("mass", "viscous", "coulomb", "actuation_delay.delay")
TRUE = {"mass": 0.056, "viscous": 2.0e-5, "coulomb": 1.1e-3}
DELAY = 0.012


@dataclass(frozen=True)
class Run:
    """One optimiser's result: cost, values and what it took."""

    cost: float
    values: tuple[float, ...]
    seconds: float
    simulations: int


class Residuals:
    """Whitened residuals of all windows as a function of parameters and initial states, prior rows last."""

    def __init__(self, question: FitRequest, state: torch.Tensor) -> None:
        self.question, self.problem = question, question.problem()
        self.columns = [self.problem.names.index(n) for n in ASKED]
        self.sd = np.sqrt(np.diag(question.prior.covariance))
        self.state = state
        self.start = np.concatenate([[question.start[n] for n in ASKED], state.numpy().ravel()])
        self.simulations = 0

    def lanes(self, points: np.ndarray) -> np.ndarray:
        """Residuals (L, samples + p) of points (L, p + states)."""
        count = len(ASKED)
        theta = np.tile([[self.question.start[n] for n in self.problem.names]], (len(points), 1))
        theta[:, self.columns] = points[:, :count]
        state = torch.from_numpy(points[:, count:].copy()).reshape(len(points), *self.state.shape)
        zero = torch.zeros(len(points), self.problem.zeros.count, dtype=torch.float64)
        predicted = self.problem.predict(theta, state, zero)
        self.simulations += len(points)
        data = ((self.problem.windows.value - predicted) * self.problem.weight).flatten(1).numpy()
        prior = (points[:, :count] - self.question.prior.mean(ASKED)) / self.sd
        return np.concatenate([data, prior], 1)

    def __call__(self, point: np.ndarray) -> np.ndarray:
        return self.lanes(point[None])[0]

    def pattern(self) -> np.ndarray:
        """Which residual depends on what: parameters on all, initial states on their own window."""
        count, windows, size = len(ASKED), *self.state.shape
        rows = self.problem.windows.valid[0].numel()
        result = np.zeros((windows * rows + count, count + windows * size))
        result[:, :count] = 1
        for w in range(windows):
            result[w * rows : (w + 1) * rows, count + size * w : count + size * (w + 1)] = 1
        return result

    def jacobian(self, point: np.ndarray) -> np.ndarray:
        """By finite differences in one batch; the states of all windows are moved at once."""
        count, windows, size = len(ASKED), *self.state.shape
        steps = [PARAMETER_STEP * self.problem.scale[c] for c in self.columns] + [1e-6] * size
        points = np.repeat(point[None], 1 + len(steps), 0)
        for i, step in enumerate(steps):
            points[1 + i, i if i < count else slice(i, None, size)] += step
        lanes = self.lanes(points)
        slopes = (lanes[1:] - lanes[0]) / np.array(steps)[:, None]
        result = np.zeros((lanes.shape[1], len(point)))
        result[:, :count] = slopes[:count].T
        rows = self.problem.windows.valid[0].numel()
        for w in range(windows):
            own = slice(w * rows, (w + 1) * rows)
            result[own, count + size * w : count + size * (w + 1)] = slopes[count:, own].T
        return result


def compare(seconds: float, repeats: int) -> dict:
    """All optimisers on one log, in turn."""
    spec = make_unit("pendulum", parameters=TRUE, effects={"actuation_delay": {"delay": DELAY}}, seed=1)
    log = record(spec, "steps", seconds, clock="simulated", seed=1)
    with one_thread():
        question = make_request([log], "pendulum", ASKED)
        question = replace(question, start=question.start | {"actuation_delay.delay": 0.005})
        state, _ = question.problem().fit_states(question.start, question.windows.state)
        runs: dict[str, list[Run]] = {}
        for _ in range(repeats):
            for name, run in OPTIMISERS.items():
                runs.setdefault(name, []).append(run(question, state))
    best = min(run.cost for all_ in runs.values() for run in all_)
    rows = {}
    for name, all_ in runs.items():
        rows[name] = {
            "cost_above_best": all_[0].cost - best,
            "seconds": float(np.median([run.seconds for run in all_])),
            "simulations": all_[0].simulations,
            "values": dict(zip(ASKED, all_[0].values, strict=True)),
        }
    ours = rows["deepkoco"]["seconds"]
    return {
        "seconds_of_log": seconds,
        "windows": len(question.windows),
        "unknowns": len(ASKED) + state.numel(),
        "samples": question.windows.samples,
        "optimisers": rows,
        "time_ratio": {name: row["seconds"] / ours for name, row in rows.items() if name != "deepkoco"},
    }


def ours(question: FitRequest, state: torch.Tensor) -> Run:
    """Levenberg-Marquardt with the states eliminated."""
    problem = question.problem()
    began = time.process_time()
    fit = problem.fit([Trial("fit", ASKED, question.prior, question.start, state)], 60, TOLERANCE)[0]
    seconds = time.process_time() - began
    lanes = 1 + len(ASKED) + state.shape[1]
    return Run(fit.cost, tuple(fit.values[n] for n in ASKED), seconds, lanes * len(fit.history))


def scipys(jacobian: Callable[[Residuals], dict]) -> Callable[[FitRequest, torch.Tensor], Run]:
    """SciPy's trust region with a way to differentiate."""

    def run(question: FitRequest, state: torch.Tensor) -> Run:
        residuals = Residuals(question, state)
        bounds = {p.name: (p.low, p.high) for p in question.declared}
        free = np.full(state.numel(), np.inf)
        low, high = (
            np.concatenate([[bounds[n][side] for n in ASKED], sign * free])
            for side, sign in ((0, -1), (1, 1))
        )
        scale = np.concatenate(
            [[residuals.problem.scale[c] for c in residuals.columns], np.full(len(free), 0.01)]
        )
        began = time.process_time()
        # The tolerance that stops it where ours stops: a fall of the cost by TOLERANCE.
        found = least_squares(
            residuals,
            residuals.start,
            bounds=(low, high),
            x_scale=scale,
            ftol=TOLERANCE / question.windows.samples,
            xtol=1e-12,
            gtol=1e-12,
            **jacobian(residuals),
        )
        seconds = time.process_time() - began
        return Run(2.0 * found.cost, tuple(found.x[: len(ASKED)]), seconds, residuals.simulations)

    return run


OPTIMISERS: dict[str, Callable[[FitRequest, torch.Tensor], Run]] = {
    "deepkoco": ours,
    "scipy, sparse differences": scipys(lambda r: {"jac_sparsity": r.pattern()}),
    "scipy, Jacobian in one batch": scipys(lambda r: {"jac": r.jacobian}),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the comparison and print it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=21.0, help="length of the log [s]")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    if args.seconds < 4.0 or args.repeats < 1:
        parser.error("give at least 4 seconds and one repeat")
    result = compare(args.seconds, args.repeats)
    if args.json:
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
        return 0
    for name, row in result["optimisers"].items():
        sys.stdout.write(
            f"{name:32s} {row['seconds']:8.2f} s {row['simulations']:6d} simulations, "
            f"cost {row['cost_above_best']:.2e} above the best\n"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

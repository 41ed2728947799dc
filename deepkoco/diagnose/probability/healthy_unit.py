"""Prior from healthy logs of the unit: they show its parameters, effects, smooth function and model error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from deepkoco.diagnose.baseline import Healthy
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.probability.amplitudes import Amplitudes
from deepkoco.diagnose.probability.columns import columns_at, zeros_of
from deepkoco.diagnose.probability.coordinates import coordinates_of, spreads, tolerances
from deepkoco.diagnose.probability.gram import Gram, WindowSums
from deepkoco.diagnose.probability.hierarchy import of_next_log
from deepkoco.diagnose.probability.model_error import in_time, of_motion, ranges_of, slot_responses
from deepkoco.diagnose.probability.normal import Changes, Normal
from deepkoco.diagnose.probability.unit import declared_of, shifted, stacked
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.fit import FitProblem

RUN_TO_RUN = (0.1, 0.3, 1.0, 2.0)  # multiples of the usual standard deviations from log to log
KEPT = 10.0  # nats behind the best from which a size of the model error is left out


@dataclass(frozen=True)
class HealthyUnit:
    """Prior of a further log of a unit whose healthy logs are known.

    Attributes:
        tolerated: Parameters of the tolerated changes, in the order of the prior.
        amplitudes: Sizes of the model error; those of an unknown cause come after those that the logs show.
        ranges: Lowest and highest angle, speed and effort of the healthy logs.
        priors: Prior of a further log at each size.
    """

    tolerated: tuple[str, ...]
    amplitudes: Amplitudes
    ranges: Sequence[np.ndarray]
    priors: tuple[Normal, ...]

    def normal(self, number: int) -> Normal:
        """Return the prior for one size of the model error."""
        return self.priors[number]


def learned_unit(healthy: Healthy, causes: Sequence[Cause]) -> HealthyUnit:
    """Learn the prior of a further log.

    Args:
        healthy: The healthy logs, and the system before it was learned from them.
        causes: The catalogue.
    """
    start = healthy.before
    windows = replace(healthy.windows, varies={})
    problem, origin = FitProblem(start.system, windows), refit(start, windows)
    missing = missing_torque(problem, origin)
    hints = Hints(start.system.base, windows, missing, origin.chi2 / windows.samples)
    catalogue = coordinates_of(problem, start.prior.names, origin.values, causes, hints)
    inside, loose = tolerances(catalogue, True)
    own = len(catalogue.base)
    chosen = [*range(own), *inside.tolist()]
    columns = columns_at(problem, origin, [catalogue.coordinates[k] for k in chosen])
    responses, ranges = slot_responses(problem, origin), ranges_of(problem, missing)
    smooth = of_motion(problem, responses, missing, ranges)
    sudden = in_time(responses, problem.system.joints)
    both = np.concatenate([columns.changes, smooth], axis=2)
    zeros = zeros_of(problem)
    logs = [
        WindowSums(
            np.concatenate([both[mine], zeros[mine]], 2),
            columns.states[mine],
            sudden[mine],
            columns.residual[mine],
        )
        for mine in (windows.log == k for k in np.unique(windows.log))
    ]
    here = np.concatenate([[origin.values[n] for n in catalogue.base], np.zeros(both.shape[2] - own)])
    declared = declared_of(start, catalogue.base)
    usual = spreads(problem, catalogue, inside)
    return _over_sizes(
        logs,
        tuple(catalogue.coordinates[k].parameter for k in inside),
        here,
        stacked(declared, Normal.independent(loose)),
        usual,
        smooth.shape[2],
        problem.zeros.spread,
        ranges,
    )


def _over_sizes(
    logs: Sequence[WindowSums],
    tolerated: tuple[str, ...],
    here: np.ndarray,
    declared: Normal,
    usual: np.ndarray,
    weights: int,
    zeros: np.ndarray,
    ranges: Sequence[np.ndarray],
) -> HealthyUnit:
    """Return the prior at each size of the model error and of the run-to-run variation that the logs allow."""
    grid = Amplitudes.grid(True)
    grams: dict[float, list[Gram]] = {}
    edges = np.concatenate([[0.0], np.sqrt(np.array(RUN_TO_RUN[1:]) * RUN_TO_RUN[:-1]), [np.inf]])
    log_runs = np.log(np.diff(scipy.special.erf(edges / np.sqrt(2.0))))
    found: list[tuple[float, int, Normal]] = []
    for a in np.flatnonzero(grid.log_healthy > grid.log_healthy.max() - 30.0):
        r = float(grid.in_time[a])
        grams.setdefault(r, [_without_zeros(own.at(r), zeros) for own in logs])
        mean = shifted(stacked(declared, Normal.independent(np.full(weights, grid.of_motion[a]))), -here)
        for k, factor in enumerate(RUN_TO_RUN):
            spread = np.concatenate([factor * usual, np.zeros(weights)])
            normal, log_evidence = of_next_log(grams[r], mean, spread)
            found.append(
                (log_evidence + float(grid.log_healthy[a] + log_runs[k]), int(a), shifted(normal, here))
            )
    top = max(weight for weight, _, _ in found)
    total = top + np.log(sum(np.exp(weight - top) for weight, _, _ in found))
    kept = [(weight - total, a, normal) for weight, a, normal in found if weight > top - KEPT]
    likeliest = max(kept, key=lambda entry: entry[0])[2]
    wider = [_with_unknown(likeliest, float(s), weights) for s in grid.of_motion]
    order = [a for _, a, _ in kept]
    none = np.full(len(kept), -np.inf)
    sizes = Amplitudes(
        np.concatenate([grid.of_motion[order], grid.of_motion]),
        np.concatenate([grid.in_time[order], grid.in_time]),
        np.concatenate([[weight for weight, _, _ in kept], np.full(len(grid), -np.inf)]),
        np.concatenate([none, grid.log_unknown]),
    )
    return HealthyUnit(tolerated, sizes, ranges, (*(normal for _, _, normal in kept), *wider))


def _without_zeros(gram: Gram, spread: np.ndarray) -> Gram:
    """Integrate the zeros of encoders, which come last; those of other logs have no columns here."""
    count = len(gram.pull) - len(spread)
    if len(spread) == 0:
        return gram
    found = Changes.of(gram, Normal.independent(spread), count + np.arange(len(spread)))
    return Gram(found.information[:count, :count], found.pull[:count], -2.0 * found.log_nothing, 0.0)


def _with_unknown(normal: Normal, amplitude: float, weights: int) -> Normal:
    """Add the smooth function of an unknown cause to that of the unit."""
    covariance = np.linalg.inv(normal.precision)
    last = np.arange(len(covariance) - weights, len(covariance))
    covariance[last, last] += amplitude**2
    return Normal.of(normal.mean, np.linalg.inv(covariance))

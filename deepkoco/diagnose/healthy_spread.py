"""Healthy logs refitted together and each with parameters of its own, and how these vary from run to run."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Healthy
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.evidence.priors import freed, prior_with
from deepkoco.diagnose.evidence.selection import PATIENCE
from deepkoco.diagnose.per_log_refits import ROUNDS, SETTLED, run_to_run, with_floor
from deepkoco.diagnose.residuals.residuals import white_limit
from deepkoco.diagnose.run_to_run import RunToRun
from deepkoco.fit.data.per_log_differences import may_differ
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import DivergedError


def jointly_fitted(healthy: Healthy) -> Healthy:
    """Return healthy logs with a fit whose prior counts as much as the residuals that it leaves let the logs count.

    Args:
        healthy: The logs, their effects and a fit.
    """
    for _ in range(ROUNDS):
        left = dispersion(healthy.fit, healthy.windows)
        wanted = left.deflation if left.chi2_per_sample > white_limit(healthy.windows) else 1.0
        if SETTLED <= wanted / healthy.tempering <= 1.0 / SETTLED:
            break
        again = replace(healthy, tempering=wanted)
        counted, problem = again.counted()
        try:
            # Another weight of the prior mostly moves the same minimum.
            trial = freed(problem, counted, healthy.causes, healthy.fit, healthy.fit.values)
            fit = problem.fit_one(trial, PATIENCE)
            if (healthy.fit.stuck or fit.stuck) and not (healthy.causes or healthy.windows.varies):
                fit = min(fit, refit(counted, problem.windows), key=lambda own: own.cost)
        except DivergedError:
            break  # the fit under the declared prior stays
        healthy = replace(again, fit=fit)
    return healthy


class Spread(NamedTuple):
    """Healthy logs refitted with their own parameters, and how these vary from run to run.

    Attributes:
        healthy: The refitted logs.
        runs: The variance, with the floor that separate refits leave; None for fewer than two long enough logs.
        prior: Prior of a log's parameters, before any log.
    """

    healthy: Healthy
    runs: RunToRun | None
    prior: Prior

    def with_floor(self) -> Spread:
        """Return the same with the floor that the mean of all logs leaves.

        Raises:
            DivergedError: The simulation of a log diverges under what all of them tell.
        """
        return (
            self if self.runs is None else self._replace(runs=with_floor(self.runs, self.healthy, self.prior))
        )


def spread_of(healthy: Healthy) -> Spread:
    """Estimate the run-to-run variance of healthy logs, and refit them with their own parameters within it.

    Args:
        healthy: The logs, their effects and a fit.
    """
    healthy = jointly_fitted(healthy)
    before, fit = healthy.before, healthy.fit
    problem = FitProblem(before.system, healthy.windows)
    prior = prior_with(problem, before, healthy.causes, fit.values)
    runs = run_to_run(healthy, prior)
    if runs is None:
        return Spread(healthy, None, prior)
    may = may_differ(before.system)
    # That of these logs. What is doubted of it is for a further log; here it would be freedom to take up model error.
    variance = dict(zip(prior.names, np.diag(runs.covariance).tolist(), strict=True))
    varies = {
        n: math.sqrt(v) for n, v in variance.items() if n in may and n in before.prior.names and v > 0.0
    }
    if varies == healthy.windows.varies:
        return Spread(healthy, runs, prior)
    # The fit starts from the mean of these logs, because a new variance may move this mean.
    values = problem.values_in(fit)
    healthy = replace(healthy, windows=replace(healthy.windows, varies=varies))
    if healthy.tempering > 1.0:
        healthy = replace(healthy, tempering=max(1.0, runs.floor * runs.correlation))
    counted, again = healthy.counted()
    trial = freed(problem, counted, healthy.causes, fit, values)
    nuisance = again.nuisances.none()
    nuisance[: again.zeros.count] = fit.nuisance[: again.zeros.count]
    healthy = replace(healthy, fit=again.fit_one(replace(trial, nuisance=nuisance)))
    return Spread(healthy, runs, prior)

"""What healthy logs of the same unit teach: its parameters, its model-error floor, its spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Start, refit, refit_sharply, start_from
from deepkoco.diagnose.causes import Cause, catalogue
from deepkoco.diagnose.causes.timing import LOST_COMMANDS
from deepkoco.diagnose.elimination import eliminated
from deepkoco.diagnose.hints import Hints
from deepkoco.diagnose.losses import best_losses
from deepkoco.diagnose.residuals import dispersion, missing_torque
from deepkoco.diagnose.selection import DETECTION, prior_with, rank
from deepkoco.diagnose.settling import front_settled
from deepkoco.graph.recording import Recording
from deepkoco.identify.fit import Fit, FitProblem
from deepkoco.identify.prior import Prior
from deepkoco.identify.windows import cut_windows, moving
from deepkoco.systems import System

# A healthy unit may need several small extensions before only noise is left.
LARGEST_EXTENSION = 6


def learn_baseline(recordings: Sequence[Recording], system: System, length: float) -> Start:
    """Refit, and where needed extend, the baseline on logs in which nothing is wrong.

    Small effects that every log of the unit shows (a lag of 2 ms, some load friction) would be taken for
    causes later on. Forward selection on the healthy logs adds them to the baseline; the uncertainty of
    that fit becomes the prior of the diagnosis, and its chi2 per sample the floor. With two or more logs
    the spread of their separate refits widens the prior: real parameters vary from run to run.

    Args:
        recordings: Healthy logs.
        system: The system.
        length: Length of the windows [s].
    """
    windows = cut_windows(recordings, system, length)
    windows = windows.take(moving(windows))
    start = start_from(system, windows)
    windows, fit = refit_sharply(start, windows)
    problem = FitProblem(start.system, windows)
    accepted: list[Cause] = []
    causes = [c for c in catalogue(start.system.base).values() if c.effect != "event" and c.free]
    for _ in range(LARGEST_EXTENSION):
        hints = Hints(start.system, windows, missing_torque(problem, fit), fit.chi2 / windows.samples)
        ranking = rank(problem, start, fit, accepted, hints, causes)
        if ranking.best.delta_bic < DETECTION:
            break
        best = front_settled(problem, start, accepted, ranking).best
        # A mixture that was found first is superfluous once its parts are there; it must not come back.
        causes = [c for c in causes if c.name != best.cause.name]
        accepted, fit = eliminated(problem, start, [*accepted, best.cause], best.fit, DETECTION)
    prior = prior_with(problem, start, accepted, fit.values)
    centre = np.array([fit.values[n] for n in prior.names])
    lost = [c for c in catalogue(start.system.base).values() if c.kind == LOST_COMMANDS.name]
    losing = tuple(c.index for c in lost if best_losses(problem, fit, prior, [c], 1.0, DETECTION) is not None)
    spread = dispersion(fit, windows)
    covariance = fit.covariance * spread.deflation + _run_to_run(
        recordings, system, length, replace(start, prior=prior), fit
    )
    return replace(
        start,
        values=dict(fit.values),
        prior=Prior(prior.names, centre, covariance),
        floor=max(1.0, spread.chi2_per_sample),
        effects=tuple(dict.fromkeys(c.effect for c in accepted)),
        losing=losing,
    )


def _run_to_run(
    recordings: Sequence[Recording], system: System, length: float, start: Start, pooled: Fit
) -> np.ndarray:
    """Covariance (diagonal) of the parameters between logs, 0 for a single log.

    Each log is refitted by itself, with everything free that the pooled fit freed; what the logs differ by beyond
    the uncertainty of their fits is the unit's own spread.
    """
    size = len(pooled.free)
    if len(recordings) < 2:
        return np.zeros((size, size))
    fits = []
    for recording in recordings:
        windows = cut_windows([recording], system, length)
        windows = windows.take(moving(windows))
        if len(windows) >= 3:
            own = replace(start, values=dict(pooled.values))
            fits.append(refit(own, windows, start.prior.names))
    if len(fits) < 2:
        return np.zeros((size, size))
    result = np.zeros((size, size))
    for i, name in enumerate(pooled.free):
        if name in fits[0].free:
            j = fits[0].free.index(name)
            between = np.var([f.values[name] for f in fits], ddof=1)
            within = np.mean([f.covariance[j, j] for f in fits])
            result[i, i] = max(float(between - within), 0.0)
    return result

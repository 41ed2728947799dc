"""Choose the integration step by the log: the error of a simulation must be less than what the log can tell.

A step that is stable and follows the fastest motion can still be wrong by more than a fine encoder shows: the instant
at which a joint turns or comes to rest is found from one mean acceleration for the whole step, and a servo answers each
new command faster than it moves. In some windows the motion itself makes small errors large. What is left looks like a
small push or tone, and no value of any parameter removes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit_types import Fit
from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.solve.dispersion import dispersion

# Squared error over all samples, in variances of the noise: no cause can be named for less than it explains.
UNSEEN = 24.0
MOST = 8  # parts of a step
EQUAL = 0.05  # relative difference up to which steps are the same: windows of other lengths have others
# Of a fit and a choice of steps: a fit can hide errors of its steps, which the next one shows.
STEP_ROUNDS = 3


def fine_steps(
    problem_of: Callable[[Windows], ShootingProblem], windows: Windows, fit: Fit, most: int = MOST
) -> int:
    """Return into how many parts each integration step must be cut: a power of two.

    The error of a step is its difference from the finest one. Half a step does not tell it: two coarse steps can both
    miss the instant at which a joint turns, and agree. The error is compared with the residuals of the fit: where
    something larger is missing, a fine step shows nothing more. Residuals that finer steps remove are no such reason,
    so those of the finest step count where they are smaller.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows.
        fit: A fit of them; its parameters, initial states and nuisances are simulated.
        most: Largest number of parts, a power of two.
    """
    parts, own = 1, _simulated(problem_of, windows, fit, 1)
    finest = _simulated(problem_of, windows, fit, most)
    # The fit may be of other noise than these windows have.
    target = problem_of(windows).weighed(windows.value)
    left = (replace(fit, residual=target - simulated) for simulated in (own, finest))
    told = UNSEEN * min(dispersion(each, windows).deflation for each in left)
    while parts < most and float((finest - own).square().sum()) > told:
        parts *= 2
        own = _simulated(problem_of, windows, fit, parts) if parts < most else finest
    return parts


def steps_to_compare(
    problem_of: Callable[[Windows], ShootingProblem],
    windows: Windows,
    fit: Fit,
    better: Fit,
    most: int = MOST,
) -> int:
    """Return into how many parts each integration step must be cut before a fit is known to be worse than another.

    A misfit is a distance, so an error of the simulation changes it by its own length at most. Steps that suit one
    explanation need not suit another: a delay lets commands change within a step. As in :func:`fine_steps`, the error
    of a step is its difference from the finest one.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows.
        fit: A fit of them that is worse.
        better: A fit of them that is better.
        most: Largest number of parts, a power of two.
    """
    parts, own = 1, _simulated(problem_of, windows, fit, 1)
    finest = _simulated(problem_of, windows, fit, most)
    while parts < most:
        error = float((finest - own).square().sum())
        if not error > UNSEEN or not fit.chi2**0.5 - error**0.5 < better.chi2**0.5:
            break
        parts *= 2
        own = _simulated(problem_of, windows, fit, parts) if parts < most else finest
    return parts


def with_steps_cut(windows: Windows, parts: int) -> Windows:
    """Return windows whose integration steps are cut into so many equal parts; steps of the system's own stay."""
    if windows.own_steps:
        return windows
    return replace(windows, step=windows.step / parts, steps=windows.steps * parts)


def with_steps_of(windows: Windows, step: float) -> Windows:
    """Return windows with steps no longer than a given one, as far as ``MOST`` parts of a step allow.

    Steps of the system's own stay.

    Args:
        windows: The windows.
        step: The longest step [s]; infinite for any.
    """
    parts = parts_of(windows, step)
    return with_steps_cut(windows, parts) if parts > 1 else windows


def parts_of(windows: Windows, step: float) -> int:
    """Return into how many parts the integration steps of windows are cut: a power of two, ``MOST`` at most.

    Args:
        windows: The windows.
        step: The longest step [s]; infinite for any.
    """
    parts = 1
    while parts < MOST and windows.step / parts > step * (1.0 + EQUAL):
        parts *= 2
    return parts


def _simulated(
    problem_of: Callable[[Windows], ShootingProblem], windows: Windows, fit: Fit, parts: int
) -> Tensor:
    """Return the simulated measurements (W, N, M) of a fit, in standard deviations of the noise; 0 where padded."""
    problem = problem_of(with_steps_cut(windows, parts))
    theta = np.array([[float(fit.values[n]) for n in problem.names]])
    return problem.weighed(problem.predict(theta, fit.state[None], fit.nuisance[None])[0])

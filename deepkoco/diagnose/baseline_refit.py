"""Refits of a baseline to windows: on shorter ones first, under the noise that they show, in steps fine enough."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline, counting_floor
from deepkoco.diagnose.residuals.residuals import white_limit
from deepkoco.diagnose.shorter_first import shorter_first
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import ITERATIONS, Fit, FitProblem, Trial
from deepkoco.fit.solve.command_noise import with_command_noise, with_noise_like
from deepkoco.fit.solve.fine_steps import MOST, STEP_ROUNDS, fine_steps, with_steps_cut, with_steps_of
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes
from deepkoco.fit.solve.guessed_commands import with_lost_rows_fitted
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.levenberg_marquardt import TO_BEGIN, TOLERANCE
from deepkoco.fit.solve.residual_noise import with_sharp_noise
from deepkoco.fit.solve.rounded_commands import with_rounded_commands
from deepkoco.fit.solve.scaled_inverse import DivergedError

LONG = 75  # iterations of a refit that starts far from its minimum
FEW_WINDOWS = (
    20  # of a log, or half the number of parameters, that give a fit of many parameters its start values
)


def refit(
    start: Baseline,
    windows: Windows,
    free: tuple[str, ...] | None = None,
    first: Fit | None = None,
    tolerance: float = TOLERANCE,
) -> Fit:
    """Fit the baseline's parameters under their prior, first on windows of half the length or shorter.

    The cost of a long window across an unstable equilibrium has many minima; that of half windows has fewer. The fit
    on half windows gives the start values of parameters and initial states for the full windows. Where one of these
    fits ends without a minimum, as in a valley of stick and slip that no slope leaves, or the second one diverges, the
    full windows are fitted from the present values too, and the lower cost is kept.

    Args:
        start: Prior and present values.
        windows: The windows to fit.
        free: Parameters to free; None frees all that the prior covers.
        first: The fit on half windows, where it is known.
        tolerance: Of the cost, as for :meth:`.FitProblem.fit`.

    Returns:
        The fit of the full windows.

    Raises:
        DivergedError: The simulation diverges at the present values, and at those of the fit on half windows.
    """
    names = start.prior.names if free is None else free
    first = from_shorter_windows(start, windows, names) if first is None else first
    problem = FitProblem(start.system, windows)
    guess = windows.state.clone()
    guess[torch.from_numpy(few_windows(windows, len(names)))] = first.state[::2]
    state, _ = problem.fit_states(first.values, guess)
    trial = Trial("refit", names, start.prior, first.values, state, first.nuisance)
    found = problem.fit([trial], tolerance=tolerance)[0]
    if not (first.stuck or found.stuck or found.diverged):
        return found
    state, _ = problem.fit_states(start.values, windows.state)
    again = problem.fit([Trial("refit", names, start.prior, start.values, state)], LONG, tolerance)[0]
    if again.diverged and found.diverged:
        raise problem.divergence(trial, found)
    return found if again.diverged or (not found.diverged and found.cost <= again.cost) else again


def on_half_windows(
    start: Baseline,
    windows: Windows,
    names: tuple[str, ...],
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    known: SlopesOfHalves | None = None,
) -> Fit:
    """Fit the parameters on windows of half the length; with many parameters, on an even choice of them.

    Args:
        start: Prior and present values.
        windows: The windows.
        names: Parameters to free.
        iterations: Largest number of simulations.
        tolerance: Of the cost, as for :meth:`.FitProblem.fit`.
        known: Slopes of a fit under nearly the same law, for the same samples; None computes them.

    Raises:
        DivergedError: The simulation diverges at the present values.
    """
    short = _half_windows(start, windows, names)
    state, _ = short.fit_states(start.values, short.windows.state)
    trial = Trial("half windows", names, start.prior, start.values, state)
    slopes = None if known is None else known.of(short.windows)
    return short.fit_one(trial, iterations, tolerance, slopes, exact=slopes is None)


class SlopesOfHalves(NamedTuple):
    """Slopes of a fit on half windows.

    Attributes:
        windows: The half windows.
        slopes: Whitened slopes.
    """

    windows: Windows
    slopes: FrozenSlopes

    def of(self, windows: Windows) -> FrozenSlopes | None:
        """Return the slopes for half windows of the same samples; None where these are cut elsewhere.

        An engine whose steps are those of the commands cuts between two of them, and a machine in the middle.
        """
        own = self.windows
        same = windows.t.shape == own.t.shape and (windows.t0 == own.t0).all()
        same = same and torch.equal(windows.t, own.t) and torch.equal(windows.valid, own.valid)
        return self.slopes if same else None


def slopes_on_half_windows(start: Baseline, windows: Windows, fit: Fit) -> SlopesOfHalves | None:
    """Return the slopes of a fit on half windows, for fits under nearly the same law; None where these compute theirs.

    Args:
        start: Its prior.
        windows: Its windows.
        fit: The fit.
    """
    problem = _half_windows(start, windows, fit.free)
    if not problem.keeps_slopes([Trial("slopes", fit.free, start.prior, fit.values, fit.state)]):
        return None
    slopes = problem.slopes_at(fit.values, fit.free, fit.state, fit.nuisance)
    return SlopesOfHalves(problem.windows, slopes)


def _half_windows(start: Baseline, windows: Windows, names: tuple[str, ...]) -> FitProblem:
    return FitProblem(start.system, halved(windows.take(few_windows(windows, len(names)))))


def from_shorter_windows(
    start: Baseline, windows: Windows, names: tuple[str, ...], begun: bool = False
) -> Fit:
    """As :func:`on_half_windows`, with windows as short as it takes to find a minimum (:mod:`.shorter_first`).

    Args:
        start, windows, names: As there.
        begun: As for :func:`.shorter_first`.

    Raises:
        DivergedError: The simulation diverges at the present values, and at those of shorter windows.
    """
    halves = halved(windows.take(few_windows(windows, len(names))))
    return shorter_first(start.system, start.values, start.prior, names, halves, begun=begun)


def first_refit(start: Baseline, windows: Windows) -> tuple[Windows, Fit]:
    """Fit on windows of half the length or shorter, and ask whether the commands of the log have noise.

    Args:
        start: Prior and present values.
        windows: The windows.

    Returns:
        The windows, with their most likely commands and what noise of these does, and the fit on the half windows.

    Raises:
        DivergedError: The simulation diverges at the present values.
    """
    if start.near is not None:
        try:
            begun = any(n in start.near.values for n in start.prior.names)
            return _first_refit(start.begun(), windows, begun)
        except DivergedError:
            start = replace(start, near=None)
    return _first_refit(start, windows)


def _first_refit(start: Baseline, windows: Windows, begun: bool = False) -> tuple[Windows, Fit]:
    """As :func:`first_refit`, from the present values.

    Args:
        start, windows: As there.
        begun: Whether earlier fits of these logs have led to these values.
    """
    names, problem_of = start.prior.names, partial(FitProblem, start.system)
    windows = with_steps_of(windows, start.step)
    if windows.wander is None:
        # Without it, long windows find no minimum.
        windows = with_noise_like(problem_of, windows, start.values, start.wander)
    first = from_shorter_windows(start, windows, names, begun)
    chosen = few_windows(windows, len(names))
    halves = windows.valid[chosen].sum()
    if windows.wander is not None or first.chi2 <= white_limit(windows) * float(halves):
        return windows, first
    state = windows.state.clone()
    state[torch.from_numpy(chosen)] = first.state[::2]
    if start.healthy is not None:
        # The recorder is that of the healthy logs. At their values, whole windows may run away.
        return with_noise_like(problem_of, windows, first.values, start.wander), first
    noisy = with_command_noise(problem_of, windows, first.values, state)
    if noisy is windows:
        return windows, first
    return noisy, on_half_windows(replace(start, values=first.values), noisy, names)


def few_windows(windows: Windows, parameters: int) -> np.ndarray:
    """Return the windows with which a fit of so many parameters can begin: an even choice of many, else all."""
    most = max(FEW_WINDOWS, parameters // 2)
    size = len(windows)
    if parameters + windows.state.shape[1] < MANY or size <= most:
        return np.arange(size)
    return np.unique(np.linspace(0, size - 1, most).astype(int))


def refit_sharply(
    start: Baseline, windows: Windows, first: Fit | None = None, usual: int | None = None
) -> tuple[Windows, Fit]:
    """Refit, estimate the noise from the residuals, and refit once more under that noise, with steps fine enough.

    Commands in the place of lost rows are fitted with it. Where more than noise is left, the noise then contains what
    the rounding of the logged commands does.

    Args:
        start: Prior and present values.
        windows: The windows.
        first: The fit on half windows, where it is known.
        usual: Integration steps of a window before any are cut; None for those that it has.

    Returns:
        The windows under the estimated noise, and the refit to them.

    Raises:
        DivergedError: The simulation diverges at the present values.
    """
    usual = windows.steps if usual is None else usual
    if first is None:
        windows, first = first_refit(start, windows)
    return _refit_sharply(replace(start, floor=1.0, correlation=1.0), windows, first, usual)


def refit_of_known_recorder(start: Baseline, windows: Windows) -> tuple[Windows, Fit]:
    """As :func:`refit_sharply`, where earlier logs of the recorder have told whether its commands have noise.

    The floor of the baseline counts as noise in the fits.

    Args:
        start: Prior and present values, with what is known of the recorder.
        windows: Windows with the noise of the sensors alone.

    Returns:
        The windows under the estimated noise of the sensors, and the refit to them.

    Raises:
        DivergedError: The simulation diverges at the present values.
    """
    usual, windows = windows.steps, with_steps_of(windows, start.step)
    problem_of = partial(FitProblem, start.system)
    if windows.wander is None:
        windows = with_noise_like(problem_of, windows, start.begun().values, start.wander)
    begun = start.near is not None and any(n in start.near.values for n in start.prior.names)
    try:
        first = from_shorter_windows(*counting_floor(start.begun(), windows), start.prior.names, begun)
    except DivergedError:
        if not begun:
            raise
        first = from_shorter_windows(*counting_floor(start, windows), start.prior.names)
    if windows.wander is None:
        # At the values of the healthy logs, whole windows may run away.
        windows = with_noise_like(problem_of, windows, first.values, start.wander)
    return _refit_sharply(start, windows, first, usual)


def refit_counting_floor(start: Baseline, windows: Windows) -> tuple[Baseline, Windows, Fit]:
    """Refit, where what the unit leaves when nothing is wrong counts as noise (:func:`.counting_floor`).

    Args:
        start: A baseline learned from healthy logs.
        windows: Windows with the noise of the sensors alone.

    Returns:
        The baseline with a floor of 1, the windows with the larger noise, and their refit.

    Raises:
        DivergedError: The simulation diverges at the present values.
    """
    windows, fit = refit_of_known_recorder(start, windows)
    return *counting_floor(start, windows), fit


def _refit_sharply(start: Baseline, windows: Windows, first: Fit, usual: int) -> tuple[Windows, Fit]:
    """As :func:`refit_sharply`; the floor of the baseline counts as noise in its fits.

    Returns:
        The windows with the noise of the sensors, and the refit under that noise and the floor.
    """
    floor, (counting, counted) = start.floor, counting_floor(start, windows)

    def problem_of(windows: Windows) -> FitProblem:
        return FitProblem(start.system, counting_floor(start, windows)[1])

    def in_noise_of_sensors(fit: Fit) -> Fit:
        return replace(fit, residual=math.sqrt(floor) * fit.residual)

    fit = refit(counting, counted, first=first, tolerance=TO_BEGIN)
    windows = with_sharp_noise(windows, in_noise_of_sensors(fit))
    windows, fit = with_lost_rows_fitted(problem_of, windows, fit, counting.prior)
    left = max(MOST * usual // windows.steps, 1)
    for further in reversed(range(STEP_ROUNDS)):
        parts = fine_steps(problem_of, windows, fit, left) if left > 1 else 1
        windows, left = with_steps_cut(windows, parts), left // parts
        trial = Trial("refit", fit.free, counting.prior, fit.values).from_fit(fit)
        last = parts == 1 or not further
        fit = problem_of(windows).fit_one(trial, tolerance=TOLERANCE if last else TO_BEGIN)
        if last:
            break
    if windows.wander is None and floor * fit.chi2 / windows.samples > white_limit(windows):
        sensors = in_noise_of_sensors(fit)
        noisy = with_rounded_commands(partial(FitProblem, start.system), windows, sensors)
        if noisy is not windows:
            trial = Trial("refit", fit.free, counting.prior, fit.values).from_fit(fit)
            windows, fit = noisy, problem_of(noisy).fit_one(trial)
    return windows, fit

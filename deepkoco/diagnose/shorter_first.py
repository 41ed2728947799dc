"""Fits that begin on the shortest windows where those of the windows themselves find no minimum, or diverge.

Over a long window, an error of the parameters adds up, joints stick in other places than they did, and the cost has
many minima. Over a short one the measurements hold the simulation near the motion: the cost is nearly that of a linear
regression of accelerations, which has one. An arm of four joints with dry friction was left at 183 noise variances by
its windows of 1.7 s and at 68 by halves of them; from windows of 53 ms, all lengths lead to 0.9.

Source: Bock, Recent advances in parameter identification techniques for ODE (1983): multiple shooting, whose short
intervals widen the region from which a fit converges.
"""

from __future__ import annotations

from collections.abc import Mapping

from deepkoco.diagnose.causes.units import LARGE_MISFIT
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import ITERATIONS, Fit, FitProblem, Trial
from deepkoco.fit.solve.levenberg_marquardt import TO_BEGIN
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import ExtendedSystem

# Noise variances up to which windows are followed so closely that a fit is on the way to the right minimum.
FOLLOWED = 4.0
FEWEST = 10  # samples of a channel in a window that show more of the motion than where it begins
# Shares of the way to the centre of the prior, of fits that begin one after the other.
NEARER = (0.0, 0.5, 1.0)


def shorter_first(
    system: ExtendedSystem,
    values: Mapping[str, float],
    prior: Prior,
    names: tuple[str, ...],
    windows: Windows,
    iterations: int = ITERATIONS,
    begun: bool = False,
) -> Fit:
    """Fit parameters on windows; where that diverges or finds no minimum, on the shortest ones first, then longer ones.

    A minimum that leaves a large misfit may be a false one, so short windows are asked there, too. A fit that follows
    the windows closely goes on first.

    Args:
        system: The extended system.
        values: Start values of all parameters.
        prior: Prior over the free ones.
        names: Parameters to free.
        windows: The windows.
        iterations: Largest number of simulations of each fit.
        begun: Whether earlier fits have led to the start values: a fit that has not come to an end is then no reason
            for shorter windows.

    Returns:
        The fit of these windows with the lower cost.

    Raises:
        DivergedError: The simulation diverges at the start values, and so does one from those of shorter windows.
    """
    problem = FitProblem(system, windows)
    state, _ = problem.fit_states(values, windows.state)
    trial = Trial("windows", names, prior, values, state)
    found = problem.fit([trial], iterations, TO_BEGIN)[0]
    if not (begun or found.converged) and found.chi2 <= FOLLOWED * windows.samples:
        found = problem.fit([trial.from_fit(found)], iterations)[0]
    good = (begun or found.converged) and not (found.diverged or found.stuck)
    if good and found.chi2 <= LARGE_MISFIT * windows.samples:
        return found
    levels = [problem]
    while (shorter := _parts(levels[-1].windows)) is not None:
        levels.append(FitProblem(system, shorter))
    if len(levels) == 1:
        if found.diverged:
            raise problem.divergence(trial, found)
        return found
    fit = _shortest(levels.pop(), values, prior, names, iterations)
    while levels and not fit.diverged:
        longer = levels.pop()
        first = fit.state[:: len(fit.state) // len(longer.windows)]
        state, _ = longer.fit_states(fit.values, first)
        fit = longer.fit(
            [Trial("windows", names, prior, fit.values, state, fit.nuisance)], iterations, TO_BEGIN
        )[0]
    if found.diverged and fit.diverged:
        raise problem.divergence(trial, found)
    return found if fit.diverged or found.cost <= fit.cost else fit


def _shortest(
    problem: FitProblem,
    values: Mapping[str, float],
    prior: Prior,
    names: tuple[str, ...],
    iterations: int,
) -> Fit:
    """Return a fit of the shortest windows; where it is stuck far from them, the best of those that begin nearer to the
    centre of the prior.

    Args:
        problem: The windows.
        values, prior, names, iterations: As for :func:`shorter_first`.
    """
    centre = dict(zip(prior.names, prior.centre.tolist(), strict=True))
    best = None
    for share in NEARER:
        begin = {**values, **{n: values[n] + share * (centre[n] - values[n]) for n in names if n in centre}}
        if best is not None and begin == values:
            break
        state, _ = problem.fit_states(begin, problem.windows.state)
        fit = problem.fit([Trial("windows", names, prior, begin, state)], iterations, TO_BEGIN)[0]
        if best is None or best.diverged or (not fit.diverged and fit.cost < best.cost):
            best = fit
        if (best.converged and not best.stuck) or best.chi2 <= LARGE_MISFIT * problem.windows.samples:
            break
    assert best is not None
    return best


def _parts(windows: Windows) -> Windows | None:
    """Return quarters of windows, or halves; None where they would not show a motion."""
    result = None
    for _ in range(2):
        if _can_be_halved(windows):
            result = windows = halved(windows)
    return result


def _can_be_halved(windows: Windows) -> bool:
    """Whether halves of windows have enough samples, and steps, to show a motion."""
    seen = windows.valid.any(0).any(-1)
    fewest = int(windows.valid.sum(-1)[:, seen].amin(0).min()) if bool(seen.any()) else 0
    return windows.steps > 1 and fewest >= 2 * FEWEST

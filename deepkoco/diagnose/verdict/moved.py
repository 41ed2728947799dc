"""Parameters that a refit moved far: the fewest with which the simulation explains a log as well as the whole refit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes.parameter import widened
from deepkoco.diagnose.diagnosis import Estimate, Moved
from deepkoco.diagnose.evidence.priors import declared
from deepkoco.diagnose.evidence.screening import SAME
from deepkoco.diagnose.evidence.selection import CLOSE, DETECTION, ITERATIONS
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.diagnose.verdict.findings import estimates, with_intervals
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import Parameter

FITTED = 4  # sets of parameters that are fitted in each round
MOST = 3  # parameters that are named
# Times the fall of chi2 that a set may lack: slopes at the refit do not hold as far as to the values given.
CLEARLY = 10.0
LOOSE = 1e-6  # information about each parameter beside that of the log, in its prior standard deviations
PATIENCE = 40  # iterations of a fit of all parameters
FAR = 2.0  # standard deviations of the prior from which a moved parameter is news


def moved_parameters(problem: FitProblem, start: Baseline, refit: Fit) -> tuple[Moved, ...]:
    """Return the fewest parameters whose new values explain the windows as well as the refit of all of them.

    Args:
        problem: Training windows.
        start: The baseline.
        refit: Refit of all parameters.

    Returns:
        The parameters, the one that explains most first. Where three do not explain the windows, because every machine
        differs a little in all of them, those that are far from their priors beside all others. Empty if the simulation
        as given explains the windows too, or if none is far from its prior.
    """
    sd = {n: math.sqrt(v) for n, v in zip(start.prior.names, start.prior.covariance.diagonal(), strict=True)}
    # The fit keeps the scale of a gauge as given. That is a choice; the value is known no better than it is declared.
    sd |= {g.fixed: start.system.parameter(g.fixed).prior_sd for g in start.gauges}
    if all(abs(refit.values[n] - start.values[n]) < FAR * sd[n] for n in sd):
        return ()
    spread = dispersion(refit, problem.windows)
    deflation = max(spread.deflation, start.least_deflation)
    # Chance alone lowers chi2 by one for each further parameter.
    enough = refit.chi2 + deflation * (DETECTION + len(refit.free))
    names = [n for n in refit.free if "." not in n]
    if not names:
        return ()
    least = _rises(problem, start, refit, list(itertools.combinations(names, min(MOST, len(names))))).min()
    if least > CLEARLY * (enough - refit.chi2):
        return _far(problem, start, refit, sd, deflation)
    best = _fewest(problem, start, refit, names, enough, sd, deflation)
    if best is None:
        return _far(problem, start, refit, sd, deflation)
    chosen = list(best.free)
    change = {n: best.values[n] - start.values[n] for n in chosen}
    if max(abs(change[n]) / sd[n] for n in chosen) < FAR:
        return ()
    # A change within a data sheet's standard deviation is no news, and such a parameter is known as it was declared.
    news = [n for n in chosen if abs(change[n]) >= sd[n]]
    found = with_intervals(problem, best.values, _beside_others(problem, refit, news, deflation))
    # Beside all others, one of them may be no other than it was given.
    news = [n for n in news if not found[n].low <= start.values[n] <= found[n].high]
    return tuple(_moved(problem, start, best, n, found[n], sd) for n in news)


def _far(
    problem: FitProblem, start: Baseline, refit: Fit, sd: Mapping[str, float], deflation: float
) -> tuple[Moved, ...]:
    """Return what the refit of all parameters moved far for certain, the farthest first; nothing where it is much.

    Their values are those of a fit in which their own priors are wide. Else these would hold them back, and parameters
    of the same scale would make up for it: a gain of 1.15 for a spring that is half as stiff.
    """
    away = {n: abs(refit.values[n] - start.values[n]) for n in refit.free if "." not in n}
    names = [n for n, change in away.items() if sd[n] > 0.0 and change >= FAR * sd[n]]
    found = estimates(problem, refit, names, deflation, start.narrowed)
    certain = [n for n in names if away[n] - (found[n].high - found[n].low) / 2.0 >= sd[n]]
    if len(certain) > MOST:
        return ()
    if not certain:
        return ()
    certain.sort(key=lambda n: -away[n] / sd[n])
    given = {n: start.values[n] for n in certain}
    prior = start.prior.widened([widened(problem.system.parameter(n)) for n in certain], given)
    if not set(refit.free) <= set(prior.names):
        return tuple(_moved(problem, start, refit, n, found[n], sd) for n in certain)
    # All of a scale lies along a curved valley, so the fit also begins where everything else is as given.
    begins = [refit, *_fits(problem, start, refit, [tuple(certain)])]
    trials = [Trial("far", refit.free, prior, b.values, b.state, b.nuisance) for b in begins]
    fits = [fit for fit in problem.fit(trials, PATIENCE) if not fit.diverged]
    fit = min(fits, key=lambda fit: fit.cost, default=refit)
    found = estimates(problem, fit, certain, deflation, start.narrowed)
    certain = [n for n in certain if not found[n].low <= start.values[n] <= found[n].high]
    return tuple(_moved(problem, start, fit, n, found[n], sd) for n in certain)


def _beside_others(
    problem: FitProblem, refit: Fit, chosen: Sequence[str], deflation: float
) -> dict[str, float]:
    """Return the variance of each chosen parameter beside all others, which are known as they are declared.

    Others keep their values given in the fit of the chosen ones, and a machine differs from these as far as they are
    declared and the log allows. A friction of which only the ratio to a mass shows is known no better than the mass.

    With the information I of the log and the declared precision P of the others (0 for the chosen ones) it is the
    diagonal of (I / deflation + P)^-1.

    Args:
        problem: Training windows.
        refit: Refit of all parameters, with the information of the log.
        chosen: Parameters whose declared values the log contradicts.
        deflation: Deflation of the residuals.
    """
    sd = [p.prior_sd for p in declared(problem, refit.free)]
    # In units of what is declared, so that nothing is lost between kilograms and radians.
    spread = np.array([s or 1.0 for s in sd])
    known = refit.information * np.outer(spread, spread) / deflation
    stated = [
        LOOSE if n in chosen else 1.0 if s > 0.0 else 1.0 / LOOSE for n, s in zip(refit.free, sd, strict=True)
    ]
    variance = np.linalg.inv(known + np.diag(stated)).diagonal() * spread**2
    return {n: float(v) for n, v in zip(refit.free, variance, strict=True) if n in chosen}


def _fewest(
    problem: FitProblem,
    start: Baseline,
    refit: Fit,
    names: Sequence[str],
    enough: float,
    sd: Mapping[str, float],
    deflation: float,
) -> Fit | None:
    """Return the fit of the fewest parameters that explain the windows; of as few, of those that are known least.

    Where a log shows two ratios of five parameters, most pairs of them explain it alike, and chance alone says which
    pair leaves the lowest chi2. What was declared of them says which is likely.

    Returns:
        The fit; None if the values given explain the windows too, or if more than ``MOST`` parameters are needed.
    """
    try:
        if problem.evaluate(start.values, "as given", refit.state).chi2 <= enough:
            return None
    except DivergedError:
        pass
    for size in range(1, min(MOST, len(names)) + 1):
        sets = list(itertools.combinations(names, size))
        likely = np.argsort(_rises(problem, start, refit, sets, deflation))[:FITTED]
        fits = _fits(problem, start, refit, [sets[k] for k in likely])
        away = {
            id(fit): sum(((fit.values[n] - start.values[n]) / sd[n]) ** 2 for n in fit.free) for fit in fits
        }
        explain = [fit for fit in fits if fit.chi2 <= enough]
        if explain:
            return min(explain, key=lambda fit: away[id(fit)])
    return None


def _rises(
    problem: FitProblem,
    start: Baseline,
    refit: Fit,
    sets: Sequence[tuple[str, ...]],
    deflation: float = 0.0,
) -> np.ndarray:
    """Return the rise of chi2 (K,) from the refit, by its slopes, if only the parameters of each set may move.

    A file that states nothing about its drives has many parameters that must move, and then no few explain the log.

    Args:
        problem: Training windows.
        start: The baseline, with the values given.
        refit: Refit of all parameters; small causes that any unit has, such as a push, may be part of it.
        sets: K sets of equally many of its parameters.
        deflation: Noise variances for which a parameter moves by a declared standard deviation from its value given;
            what all of them cost then adds to the rise.
    """
    # The declared spread only keeps combinations that the log does not tell from being undefined.
    spread = np.array([p.prior_sd for p in declared(problem, refit.free)])
    known = refit.information * np.outer(spread, spread) + LOOSE * np.eye(len(spread))
    change = np.array([start.values[n] - refit.values[n] for n in refit.free]) / spread
    slope = known @ change
    own = np.array([[refit.free.index(n) for n in names] for names in sets])
    inside = known[own[:, :, None], own[:, None, :]] + deflation * np.eye(own.shape[1])
    regained = np.einsum("ki,ki->k", slope[own], np.linalg.solve(inside, slope[own][..., None])[..., 0])
    return change @ slope - regained


def _moved(
    problem: FitProblem, start: Baseline, best: Fit, name: str, found: Estimate, sd: Mapping[str, float]
) -> Moved:
    """Return a changed parameter, or the likeliest of those that would do the same.

    Only the sum of two inertias on one shaft shows in the motion, and only the ratio of a ball's mass and the strength
    of its magnet. The change is then most likely in the one that is known least.
    """
    change, given = best.values[name] - start.values[name], start.values
    others = [n for n in sd if n != name and "." not in n and n not in best.free]
    unit = problem.system.parameter(name).unit
    added = {n: best.values[n] + change for n in others if problem.system.parameter(n).unit == unit}
    summed = _same_measurements(problem, best, name, given[name], added)
    powers: dict[str, int] = {}
    for power in (1, -1):
        scaled = {}
        if given[name] * best.values[name] > 0.0:
            factor = (best.values[name] / given[name]) ** power
            scaled = {n: best.values[n] * factor for n in others if n not in summed and best.values[n] != 0.0}
        powers |= dict.fromkeys(_same_measurements(problem, best, name, given[name], scaled), power)
    shifts = {n: given[n] - given[name] for n in (name, *summed)}
    declared = problem.system.parameter
    found_of = {
        n: _within(declared(n), found.value + d, (found.low + d, found.high + d)) for n, d in shifts.items()
    }
    for n, power in powers.items():
        found_of[n] = in_ratio(found, given[name], declared(n), given[n], power)
    away = {n: abs(e.value - given[n]) / sd[n] for n, e in found_of.items()}
    likely = min(away, key=lambda n: away[n])
    instead = tuple(
        Moved(n, given[n], found_of[n], away[n])
        for n in sorted(away, key=lambda n: away[n])
        if n != likely and (n in powers or likely in powers)
    )
    alike = tuple(n for n in shifts if n != likely) if likely in shifts else ()
    total = sum(given[n] for n in shifts) if alike else 0.0
    return Moved(likely, given[likely], found_of[likely], away[likely], alike, total, instead)


def in_ratio(found: Estimate, before: float, instead: Parameter, given: float, power: int) -> Estimate:
    """Return the value of another parameter that does the same as the value found of the one that was fitted.

    Args:
        found: Value found, of the same sign as before.
        before: Value of the fitted parameter as given.
        instead: The other parameter.
        given: Its value as given.
        power: 1 where it changes by the same factor, -1 where by the inverse one.
    """
    ratios = [v / before for v in (found.value, found.low, found.high)]
    # The inverse has no bound where the interval reaches to zero or beyond.
    value, *ends = (given * (math.inf if power < 0 and r <= 0.0 else r**power) for r in ratios)
    return _within(instead, value, ends)


def _within(parameter: Parameter, value: float, ends: Sequence[float]) -> Estimate:
    """Return a value with its interval, which ends at the bounds of the parameter."""
    low, high = max(min(ends), parameter.low), min(max(ends), parameter.high)
    return Estimate(value, min(low, value), max(high, value), parameter.unit)


def _same_measurements(
    problem: FitProblem, fit: Fit, name: str, given: float, instead: Mapping[str, float]
) -> tuple[str, ...]:
    """Return the parameters whose new value, in place of that of the named one, gives the same measurements.

    Args:
        problem: The windows.
        fit: Fit with the new value of the named parameter.
        name: That parameter.
        given: Its value as given.
        instead: Other parameters, each with the value that might do the same.
    """
    bounds = {n: problem.system.parameter(n) for n in instead}
    tried = {n: v for n, v in instead.items() if bounds[n].low <= v <= bounds[n].high}
    if not tried:
        return ()
    without = {**fit.values, name: given}
    lanes = [fit.values, without, *({**without, n: v} for n, v in tried.items())]
    theta = np.array([[lane[n] for n in problem.names] for lane in lanes])
    shown = problem.predict(theta, fit.state.repeat(len(lanes), 1, 1), fit.nuisance.repeat(len(lanes), 1))
    shown = problem.weighed(shown)
    moved = (shown[1] - shown[0]).norm()
    return tuple(
        n for n, own in zip(tried, shown[2:], strict=True) if (own - shown[0]).norm() <= SAME * moved
    )


def _fits(problem: FitProblem, start: Baseline, refit: Fit, sets: list[tuple[str, ...]]) -> list[Fit]:
    """Fit each set of parameters alone, under wide priors; the others keep the values given."""
    trials = []
    for names in sets:
        declared_wide = [widened(problem.system.parameter(n)) for n in names]
        # From the values of the refit, whose initial states are at hand; a large step from those given may diverge.
        values = {**start.values, **{n: refit.values[n] for n in names}}
        prior = Prior.of(declared_wide)
        trials.append(Trial(",".join(names), names, prior, values, refit.state, refit.nuisance, names))
    return [fit for fit in problem.fit(trials, ITERATIONS, CLOSE) if not fit.diverged]

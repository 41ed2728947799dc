"""Backward elimination: removal of causes that are superfluous or raise the held-out error."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, kind_of
from deepkoco.diagnose.evidence.absorbed import alike
from deepkoco.diagnose.evidence.event_windows import as_in
from deepkoco.diagnose.evidence.flexible import BENDING, FLEXIBLE_CAUSES, PUSHES
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import penalty
from deepkoco.diagnose.evidence.selection import CLOSE, ITERATIONS
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import QUIET
from deepkoco.fit.solve.scaled_inverse import scaled_inverse

# Times the fall of the cost at which a cause is just worth its parameters, from which no fit without it is needed.
PLAIN = 10.0
# Causes -> fit with all of them but one, by their names and its name.
Removals = dict[tuple[tuple[str, ...], str], Fit]

__all__ = ["BENDING", "FLEXIBLE_CAUSES", "PUSHES", "carried", "eliminated", "without", "without_kinds"]


def eliminated(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    fit: Fit,
    wanted: float,
    least: int = 1,
    share: float = 0.0,
    before: float = math.inf,
    exempt: Collection[Cause] = (),
    done: Removals | None = None,
) -> tuple[list[Cause], Fit]:
    """Remove causes whose delta BIC, together with all others, is too small; the weakest first.

    Forward selection may first accept a third cause that imitates a mixture of two. Once both are accepted, the
    third explains nothing more.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes in the order in which they were found.
        fit: Fit with all of them.
        wanted: Fall of the BIC that a cause needs to stay.
        least: Number of causes that stay in any case.
        share: Share of what all causes explain, which a cause needs to stay.
        before: Cost of the refit without any cause.
        exempt: Causes that may explain less than that share.
        done: Fits without one cause that are known; those that are made are added.

    Returns:
        The remaining causes and their fit.
    """
    kept = list(accepted)
    while len(kept) > least:
        spread = dispersion(fit, problem.windows)
        deflation = max(spread.deflation, start.least_deflation)
        samples, places = problem.windows.samples / spread.correlation, SLOTS * len(problem.windows)
        charge = {c.name: penalty(c, samples, places) for c in kept}
        # With no share to keep, a cause whose estimate is very far from null stays, and no fit without it is made.
        asked = [
            c
            for c in kept
            if share > 0.0
            or _squared_size(problem, start, c, fit) / deflation <= PLAIN * (wanted + charge[c.name])
        ]
        if not asked:
            break
        without_one = dict(zip(asked, _less(problem, start, kept, asked, fit, done), strict=True))
        fits = [without_one.get(c, fit) for c in kept]
        worth = [
            (less.cost - fit.cost) / deflation - charge[cause.name] if cause in without_one else math.inf
            for cause, less in zip(kept, fits, strict=True)
        ]
        most = max(before - fit.cost, 1e-300)
        # What is left by the form of another cause lowers chi2. A parameter far from what is declared of it is not left
        # by causes that are exempt, of which there is no more than on any machine.
        small = sum(less.cost - fit.cost for c, less in zip(kept, fits, strict=True) if c in exempt)
        weak = [
            k
            for k, (cause, less) in enumerate(zip(kept, fits, strict=True))
            if worth[k] <= wanted
            or (
                cause not in exempt
                and less.cost - fit.cost < share * (most - small * _mostly_prior_penalty(less, fit))
            )
        ]
        if not weak:
            break
        weakest = min(weak, key=lambda k: worth[k])
        del kept[weakest]
        fit = fits[weakest]
    return kept, fit


def _squared_size(problem: FitProblem, start: Baseline, cause: Cause, fit: Fit) -> float:
    """Return the squared distance of a cause's sizes from null in their standard deviations; 0 where unknown.

    Where the cost is quadratic as far as null, it is the rise of the cost without the cause. That is not so of a
    changed parameter, which stays free without the cause, nor of a limit, whose null is its upper bound.

    Source: Wald's test.
    """
    sizes = [n for n in cause.sizes if n in fit.free]
    if cause.effect == "event" or not sizes or not set(sizes).isdisjoint(start.prior.names):
        return 0.0
    if any(start.values[n] >= problem.system.parameter(n).high for n in sizes):
        return 0.0
    own = [fit.free.index(n) for n in sizes]
    away = np.array([fit.values[n] - start.values[n] for n in sizes])
    covariance = fit.covariance[np.ix_(own, own)]
    return float(away @ scaled_inverse(covariance) @ away) if np.isfinite(covariance).all() else 0.0


def carried(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    fit: Fit,
    held: Windows,
    least: int,
    done: Removals | None = None,
) -> tuple[list[Cause], Fit]:
    """Remove lasting causes that clearly raise the held-out error.

    A false cause improves only the windows that it is fitted to. A push stays: few of the held-out windows show it.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes.
        fit: Fit with all of them.
        held: Held-out windows.
        least: Number of causes that stay in any case, including pushes.
        done: Fits without one cause that are known; those that are made are added.

    Returns:
        The remaining causes and their fit.
    """
    kept = list(accepted)
    while len(kept) > least and (lasting := [c for c in kept if c.effect != "event"]):
        fits = _less(problem, start, kept, lasting, fit, done)
        now = held_out_chi2(problem, start, fit, held)
        # A cause can win by letting baseline parameters return to their prior instead of improving the simulation.
        # Held-out windows cannot test such a cause, so its harm is set to zero.
        harm = [
            np.zeros(len(held))
            if less.diverged or _mostly_prior_penalty(less, fit)
            else now - held_out_chi2(problem, start, less, held)
            for less in fits
        ]
        worst = max(range(len(fits)), key=lambda k: float(harm[k].sum()))
        # A cause that does not act in these windows changes their error only by chance.
        if not beyond_chance(harm[worst]):
            break
        kept.remove(lasting[worst])
        fit = fits[worst]
    return kept, fit


def held_out_chi2(problem: FitProblem, start: Baseline, fit: Fit, held: Windows) -> np.ndarray:
    """Return chi2 (W,) of a fit in each held-out window; the initial states are fitted there.

    Args:
        problem: The windows of the fit.
        start: The baseline.
        fit: The fit.
        held: Held-out windows.
    """
    unseen = FitProblem(start.system, problem.elsewhere(held, fit))
    replayed = unseen.evaluate(as_in(held, fit.values, problem.windows), "held back")
    return (replayed.residual**2).sum((1, 2)).numpy()


def beyond_chance(harm: np.ndarray) -> bool:
    """Return whether held-out errors (W,) are larger in total than their differences between windows explain."""
    return bool(harm.sum() > np.sqrt(len(harm)) * harm.std())


def _less(
    problem: FitProblem,
    start: Baseline,
    kept: Sequence[Cause],
    out: Sequence[Cause],
    fit: Fit,
    done: Removals | None = None,
) -> list[Fit]:
    """Return a fit without each of some causes; ``done`` gives those that were made before."""
    done, names = {} if done is None else done, tuple(c.name for c in kept)
    new = [c for c in out if (names, c.name) not in done]
    trials = [without(problem, start, kept, cause, fit) for cause in new]
    if start.tempering == 1.0 or not trials:
        fits = problem.fit(trials, ITERATIONS, CLOSE)
    else:
        # What is compared is large, so slopes at the fit of all causes will do, with one renewal.
        known = problem.slopes_at(fit.values, fit.free, fit.state, fit.nuisance)
        fits = problem.fit(trials, ITERATIONS, CLOSE, known, exact=False, renewals=1)
    done.update({(names, c.name): less for c, less in zip(new, fits, strict=True)})
    return [done[names, c.name] for c in out]


def _mostly_prior_penalty(less: Fit, fit: Fit) -> bool:
    """Return whether more than half of what a cause saves is penalty of the prior."""
    saved = less.cost - fit.cost
    return saved > 0.0 and less.chi2 - fit.chi2 < 0.5 * saved


def without_kinds(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], fit: Fit, kinds: Collection[str]
) -> tuple[list[Cause], Fit]:
    """Remove the causes of some kinds, unless only pushes, tones and detents are accepted.

    Detents, tones and pushes can fit nearly any structure. If structure remains in spite of them, the data do not
    support them. One stays where the simulation of the others diverges without it.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes.
        fit: Fit with all of them.
        kinds: Kinds that are removed.

    Returns:
        The remaining causes and their fit.
    """
    kept = list(accepted)
    loose = [c for c in kept if kind_of(c.name) in kinds]
    if not loose or all(kind_of(c.name) in FLEXIBLE_CAUSES for c in kept):
        return kept, fit
    for cause in loose:
        (less,) = problem.fit([without(problem, start, kept, cause, fit)], ITERATIONS, CLOSE)
        if not less.diverged:  # else the others need it
            fit = less
            kept.remove(cause)
    return kept, fit


def without(problem: FitProblem, start: Baseline, kept: Sequence[Cause], cause: Cause, fit: Fit) -> Trial:
    """Return a trial with all causes but one; it starts from the fit of all of them.

    A parameter that does the same takes up what the cause was. A fit from a friction as stated, which is half of what
    is there, would end between the two in a log whose joint sticks.

    Args:
        problem: The windows.
        start: The baseline.
        kept: All causes.
        cause: The cause that is left out.
        fit: Fit with all causes.
    """
    others = [c for c in kept if c is not cause]
    values = dict(fit.values)
    if cause.effect == "event":
        values |= QUIET
    else:
        own = {n for n in start.values if n.startswith(f"{cause.effect}.")}
        values |= {n: start.values[n] for n in own.union(cause.free)}
        values |= dict([*alike(problem, fit, cause, start.values).items()][:1])
    prior = prior_with(problem, start, others, values)
    return Trial(cause.name, prior.names, prior, values, fit.state, fit.nuisance)

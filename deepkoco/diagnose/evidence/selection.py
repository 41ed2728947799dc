"""Ranking of the catalogue: every promising cause is fitted and ranked by its fall of the BIC."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, catalogue, is_changed, kind_of
from deepkoco.diagnose.evidence.event_windows import MIN_OTHER_WINDOWS, touched
from deepkoco.diagnose.evidence.flexible import FLEXIBLE_CAUSES
from deepkoco.diagnose.evidence.footholds import CLOSE, ITERATIONS, alone, from_halves, trial_of
from deepkoco.diagnose.evidence.priors import prior_with, strained
from deepkoco.diagnose.evidence.promising import (
    WORTH,
    best_of_each_place,
    largest_promises,
    promising_starts,
)
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty
from deepkoco.diagnose.evidence.screening import Linearised, StartPoint, screen
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.prior import Prior

# Fall of the BIC that the first cause needs, and each further one. Both were calibrated on logs of units in
# which nothing is wrong (results/diagnose/), with other seeds than the tests use.
DETECTION = 24.0
FURTHER = 30.0
SCOUTING = 4  # iterations after which only the best start of each cause is continued
PROMISING_SHARE = 0.3  # share of the best candidate's fall of the cost that a candidate needs by then
PATIENCE = 40  # further iterations for a winner that has not converged
SLIPS = 4  # unit conversion constants that are fitted in full
SLIP_ITERATIONS = 6
HOPELESS = (
    10.0  # cost of a unit slip over that of the reference, from which it is not fitted with many parameters
)
FRONT = 6  # candidates that are fitted with slopes of their own, where candidates share the slopes of their reference
MOST_AS_GIVEN = 12  # causes that only the score test at the baseline's values promises
MOST_CHANGED = 6  # and changed parameters


def rank(
    problem: FitProblem,
    start: Baseline,
    reference: Fit,
    accepted: Sequence[Cause],
    hints: Hints,
    causes: Sequence[Cause] | None = None,
) -> Ranking:
    """Fit each promising cause on top of a reference and rank them by the BIC.

    Args:
        problem: Training windows.
        start: The baseline.
        reference: Fit of the baseline with the causes accepted so far.
        accepted: Those causes.
        hints: Data from which causes choose their start values.
        causes: Causes to try; None tries the whole catalogue.
    """
    everything = catalogue(problem.system.base).values() if causes is None else causes
    names = {c.name for c in accepted}
    tried = [c for c in everything if c.name not in names and c.scatter is None and not c.traced]
    if start.tempering > 1.0:
        # A hundred times slower than the others, and told from dry friction by micrometres that a large error hides.
        slow = {e.name for e in problem.system.effects if not problem.system.base.rolls(e.effect)}
        tried = [c for c in tried if c.effect not in slow]
    listed = [(cause, place) for cause in tried for place in cause.starts(hints.for_cause(cause))]
    slips = [(cause, place) for cause, place in listed if not cause.free]
    prior = prior_with(problem, start, accepted, reference.values)
    tangent = Linearised(problem, reference, prior)
    promises = screen(problem, reference, prior, [pair for pair in listed if pair[0].free], tangent)
    promising = promising_starts(promises)
    many = len(reference.free) + problem.windows.state.shape[1] >= MANY
    if many:
        spread = dispersion(reference, problem.windows)
        samples = problem.windows.samples / spread.correlation
        charge = {c.name: spread.deflation * penalty(c, samples, SLOTS * len(problem.windows)) for c in tried}
        if start.tempering > 1.0:
            # Each window shows much model error, which a push or a tone can take for its own.
            promising = promising_starts(
                [p for p in promises if kind_of(p.cause.name) not in FLEXIBLE_CAUSES]
            )
        promising = best_of_each_place(promising, charge)
    # Parameters that healthy logs freed are already part of the linearisation, so the score test underrates them.
    known, found = set(start.prior.names), {p.cause.name for p in promising}
    promising += [
        StartPoint(c, {}, WORTH)
        for c in tried
        if c.free and known.intersection(c.free) and c.name not in found and not is_changed(c)
    ]
    trials = [
        trial_of(
            problem,
            start,
            accepted,
            p.cause,
            {**reference.values, **p.values},
            reference.state,
            reference,
        )
        for p in promising
    ]
    # With many parameters, the candidates of a reference share its slopes.
    known = tangent.kept() if trials and problem.keeps_slopes(trials) else None
    slipped = _slipped(problem, start, accepted, reference, slips, HOPELESS if many else np.inf)
    if known is None:
        trials += slipped
        fits = _fit_best(problem, trials, reference)
    else:
        fits = _fit_best(problem, trials, reference, known)
        fits |= _fit_best(problem, slipped, reference)
        trials += slipped
    # With a tempered prior, the values as given are known to be no place from which anything can be told.
    far_away = start.tempering == 1.0 and strained(problem, start, reference)
    far = _screened_as_given(problem, start, reference, prior, listed) if far_away else []
    if far_away and (promising or far):
        # A strong cause drives the refit far from the true parameters, and fits return slowly from there. So each
        # cause is also fitted from the baseline's values before the refit, with initial states fitted to each start.
        also = {p.cause.name for p in promising}
        fresh = [p for p in far if p.cause.name not in also]
        far = [p for p in fresh if not is_changed(p.cause)][:MOST_AS_GIVEN]
        far += [p for p in fresh if is_changed(p.cause)][:MOST_CHANGED]
        if many:
            far = best_of_each_place(far, charge)
        promises += far
        from_given = [*promising, *far]
        before = {n: start.values[n] for n in start.prior.names}
        values = [{**reference.values, **before, **p.values} for p in from_given]
        known = None
        if problem.keeps_slopes(trials):
            foot = {**reference.values, **before}
            state, cost = problem.fit_states(foot, reference.state)
            states, costs = state.expand(len(values), -1, -1), cost.expand(len(values), -1)
            known = problem.slopes_at(foot, reference.free, state, reference.nuisance)
        else:
            states, costs = problem.fit_states_each(values, reference.state.repeat(len(values), 1, 1))
        footholds = [
            trial_of(problem, start, accepted, p.cause, values[k], states[k], reference)
            for k, p in enumerate(from_given)
            if bool(torch.isfinite(costs[k]).all()) and (known is not None or reference.converged)
        ]
        footholds = alone(problem, footholds, from_given, known)
        if known is None:  # even where the refit has found a minimum of whole windows, a cause may not
            footholds += from_halves(problem, start, accepted, from_given, values, reference)
        trials += footholds
        # These starts are fitted to the end by themselves: in the first iterations the others look better.
        for name, fit in _fit_best(problem, footholds, reference, known).items():
            if name not in fits or fit.cost < fits[name].cost:
                fits[name] = fit
    promised = largest_promises(promises)
    unfitted = tuple(name for name, fit in fits.items() if fit.diverged)
    fits = {name: fit for name, fit in fits.items() if not fit.diverged}
    ranking = _ranked(problem, start, reference, tried, fits, promised)
    # The remaining misfit of a winner that has not converged would look like a further cause. A candidate that
    # promised more than the winner's fall of the cost may only converge slowly.
    best = ranking.best.cause.name if ranking.candidates else ""
    won = reference.cost - min((fit.cost for fit in fits.values()), default=reference.cost)
    unsettled = [
        n
        for n, f in fits.items()
        if (not f.converged and (n == best or (not many and promised.get(n, 0.0) > won)))
        or (n == best and not f.exact)
    ]
    if unsettled:
        first = {name: next(t for t in trials if t.name == name) for name in unsettled}
        longer = [
            replace(first[n], values=fits[n].values, state=fits[n].state, nuisance=fits[n].nuisance)
            for n in unsettled
        ]
        fits |= dict(zip(unsettled, problem.fit(longer, PATIENCE, CLOSE), strict=True))
        ranking = _ranked(problem, start, reference, tried, fits, promised)
    return replace(ranking, unfitted=unfitted)


def _screened_as_given(
    problem: FitProblem,
    start: Baseline,
    reference: Fit,
    prior: Prior,
    listed: Sequence[tuple[Cause, Mapping[str, float]]],
) -> list[StartPoint]:
    """Return the promising starts at the baseline's values before the refit.

    Where several parameters together imitate a cause, the refit has moved them there, and the score test at the refit
    sees nothing of it: a payload within a link is another mass and another inertia of it. One parameter that changed
    much moves the others with it in the same way.
    """
    values = {**reference.values, **{n: start.values[n] for n in start.prior.names}}
    state, costs = problem.fit_states(values, reference.state)
    if not bool(torch.isfinite(costs).all()):
        return []
    there = replace(reference, values=values, state=state)
    pairs = [pair for pair in listed if pair[0].free]
    first: dict[str, StartPoint] = {}
    for point in promising_starts(screen(problem, there, prior, pairs)):
        first.setdefault(point.cause.name, point)
    return sorted(first.values(), key=lambda p: -p.promise)


def _fit_best(
    problem: FitProblem, trials: Sequence[Trial], reference: Fit, known: FrozenSlopes | None = None
) -> dict[str, Fit]:
    """Return the fit of each name: a few iterations of every trial, then more for the best trial of each name.

    Args:
        problem: The windows.
        trials: The trials; several may have one name.
        reference: Fit whose cost they lower.
        known: Slopes near their starts, which the first iterations keep.
    """
    if not trials:
        return {}
    scouts = problem.fit(trials, SCOUTING, CLOSE, known, exact=False, renewals=None if known is None else 0)
    best: dict[str, tuple[Fit, Trial]] = {}
    for trial, scout in zip(trials, scouts, strict=True):
        if trial.name not in best or scout.cost < best[trial.name][0].cost:
            best[trial.name] = (scout, trial)
    won = reference.cost - min(scout.cost for scout, _ in best.values())
    longer, running = [], []
    for name, (scout, trial) in best.items():
        # A candidate that is far behind is not continued; it would not become the winner.
        if not scout.converged and reference.cost - scout.cost > PROMISING_SHARE * won:
            running.append(name)
            longer.append(replace(trial, values=scout.values, state=scout.state, nuisance=scout.nuisance))
    longer = problem.fit(longer, ITERATIONS, CLOSE) if known is None else _fit_front(problem, longer, known)
    return {name: scout for name, (scout, _) in best.items()} | dict(zip(running, longer, strict=True))


def _fit_front(problem: FitProblem, trials: Sequence[Trial], known: FrozenSlopes) -> list[Fit]:
    """Fit trials with known slopes, then the best of them with slopes of their own."""
    fits = problem.fit(trials, ITERATIONS, CLOSE, known, exact=False, renewals=0)
    front = sorted(range(len(fits)), key=lambda k: fits[k].cost)[:FRONT]
    again = [
        replace(trials[k], values=fits[k].values, state=fits[k].state, nuisance=fits[k].nuisance)
        for k in front
    ]
    for k, fit in zip(front, problem.fit(again, ITERATIONS, CLOSE, exact=False), strict=True):
        if fit.cost <= fits[k].cost:
            fits[k] = fit
    return fits


def _slipped(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    reference: Fit,
    slips: Sequence[tuple[Cause, Mapping[str, float]]],
    most: float,
) -> list[Trial]:
    """Return trials of unit conversion constants; they start from the baseline's values before the refit.

    Args:
        problem, start, accepted, reference: As for :func:`rank`.
        slips: The constants.
        most: Cost before a fit, over that of the reference, from which a constant is left out.
    """
    if not slips:
        return []
    before = {n: start.values[n] for n in start.prior.names}
    values = [{**reference.values, **before, **place} for _, place in slips]
    states = problem.windows.state.repeat(len(slips), 1, 1)
    for k, (cause, place) in enumerate(slips):
        if cause.kind == "channel_slip":
            states[k, :, problem.windows.shows[cause.index]] /= next(iter(place.values()))
    if np.isfinite(most):
        theta = np.array([[float(v[n]) for n in problem.names] for v in values])
        shown = problem.predict(theta, states, reference.nuisance[None].repeat(len(values), 1))
        cost = (
            ((problem.windows.value - shown) * problem.weight).square().sum((1, 2, 3)).nan_to_num(torch.inf)
        )
        # Initial states lower the cost of a simulation that is right a few times, and hardly that of others.
        hopeful = [k for k in cost.argsort().tolist() if cost[k] <= most * reference.cost][: 2 * SLIPS]
        slips, values, states = [slips[k] for k in hopeful], [values[k] for k in hopeful], states[hopeful]
        if not slips:
            return []
    fitted, costs = problem.fit_states_each(values, states, SLIP_ITERATIONS)
    total = costs.sum(-1).nan_to_num(torch.inf)
    # Only the few constants with the lowest cost are fitted in full.
    return [
        trial_of(problem, start, accepted, slips[k][0], values[k], fitted[k], reference)
        for k in total.argsort()[:SLIPS].tolist()
        if bool(torch.isfinite(total[k]))
    ]


def without_events_first(
    problem: FitProblem,
    start: Baseline,
    ranking: Ranking,
    accepted: Sequence[Cause],
    hints: Hints,
    detection: float,
) -> Ranking:
    """Rank a lasting cause before a push if it is detected in the windows that the push does not touch.

    One badly fitted window can outweigh all others, and a push can improve any single window. So when a push
    leads the ranking, the causes are ranked again on the windows that it does not touch. A lasting cause that is
    detected there goes first. The push may follow in the next round.
    """
    winner = ranking.best
    if winner.cause.effect != "event":
        return ranking
    windows = problem.windows
    keep = ~touched(windows, winner.fit.values)
    if keep.sum() < MIN_OTHER_WINDOWS:
        return ranking
    rest = FitProblem(problem.system, windows.take(keep))
    pick = torch.from_numpy(np.flatnonzero(keep))
    before = Trial(
        "rest",
        ranking.reference.free,
        prior_with(problem, start, accepted, ranking.reference.values),
        {**winner.fit.values, "event.torque": ranking.reference.values["event.torque"]},
        winner.fit.state[pick],
        winner.fit.nuisance,
    )
    reference = rest.fit([before])[0]
    if reference.diverged:
        return ranking
    lasting = [c.cause for c in ranking.candidates if c.cause.effect != "event"]
    there = rank(rest, start, reference, accepted, hints, lasting)
    if not there.candidates or there.best.delta_bic <= detection:
        return ranking
    name = there.best.cause.name
    first = next(c for c in ranking.candidates if c.cause.name == name)
    if first.delta_bic <= detection:
        return ranking
    others = sorted(
        (c for c in ranking.candidates if c is not first), key=lambda c: c.cause.effect == "event"
    )
    return replace(ranking, candidates=(first, *others))


def _ranked(
    problem: FitProblem,
    start: Baseline,
    reference: Fit,
    tried: Sequence[Cause],
    fits: Mapping[str, Fit],
    promises: Mapping[str, float],
) -> Ranking:
    lowest = min([reference, *fits.values()], key=lambda fit: fit.cost)
    spread = dispersion(lowest, problem.windows)
    deflation = max(spread.deflation, start.least_deflation)
    samples = problem.windows.samples / spread.correlation
    places = SLOTS * len(problem.windows)
    candidates = []
    for cause in tried:
        if cause.name not in fits and cause.name not in promises:
            continue  # it had no start values
        # A cause with a small promise was not fitted. It is ranked with its promise, which is below every fit's ratio.
        fit = fits.get(cause.name, reference)
        ratio = reference.cost - fit.cost if cause.name in fits else promises.get(cause.name, 0.0)
        if ratio < 0.0:
            # If no start improves on the reference, the cause keeps its null value.
            fit, ratio = reference, 0.0
        score = ratio / deflation - penalty(cause, samples, places)
        candidates.append(Candidate(cause, fit, ratio, float(score)))
    candidates.sort(key=lambda c: -c.delta_bic)
    return Ranking(reference, tuple(candidates), spread, deflation, samples)

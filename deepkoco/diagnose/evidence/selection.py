"""Ranking of the catalogue: every promising cause is fitted and ranked by its fall of the BIC."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, catalogue, is_changed, kind_of
from deepkoco.diagnose.evidence.candidate_fits import fit_best
from deepkoco.diagnose.evidence.crossed import (
    FRONT,
    at_another_place,
    better_reference,
    crossed,
    gains_elsewhere,
    leaves_more,
)
from deepkoco.diagnose.evidence.curved_valley import cheapest_in_valley
from deepkoco.diagnose.evidence.event_windows import MIN_OTHER_WINDOWS, touched
from deepkoco.diagnose.evidence.exchanged_states import hides_a_position, with_exchanged_states
from deepkoco.diagnose.evidence.flexible import FLEXIBLE_CAUSES
from deepkoco.diagnose.evidence.footholds import ALONE, CLOSE, ITERATIONS, alone, from_halves, trial_of
from deepkoco.diagnose.evidence.freed_positions import with_freed_positions
from deepkoco.diagnose.evidence.minor import tolerated
from deepkoco.diagnose.evidence.natural_shapes import with_natural_shapes
from deepkoco.diagnose.evidence.priors import prior_with, strained
from deepkoco.diagnose.evidence.promising import (
    MIN_OF_BEST_CAUSE,
    MIN_OF_BEST_START,
    ROUNDS,
    WORTH,
    best_of_each_place,
    largest_promises,
    outstanding,
    promising_starts,
    simpler_frictions,
    within_reach,
)
from deepkoco.diagnose.evidence.ranking import Ranking, penalty, ranked
from deepkoco.diagnose.evidence.screening import Linearised, StartPoint, screen
from deepkoco.diagnose.evidence.second_round import (
    can_gain,
    explained_mostly,
    promising_there,
    without_hopeless_slow,
)
from deepkoco.diagnose.evidence.slips import HOPELESS, slipped
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.progress import in_company_of
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion, missing_torque
from deepkoco.diagnose.time_limit import TimeLimit
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.prior import Prior

# Fall of the BIC that the first cause needs, and each further one. Both were calibrated on logs of units in
# which nothing is wrong (results/diagnose/), with other seeds than the tests use.
DETECTION = 24.0
FURTHER = 30.0
PATIENCE = 40  # further iterations for a winner that has not converged
MOST_AS_GIVEN = 12  # causes that only the score test at the baseline's values promises
MOST_CHANGED = 6  # and changed parameters


def rank(
    problem: FitProblem,
    start: Baseline,
    reference: Fit,
    accepted: Sequence[Cause],
    hints: Hints,
    causes: Sequence[Cause] | None = None,
    limit: TimeLimit | None = None,
    worth: float = 0.0,
    wanted: float = 0.0,
    cross: bool = False,
    strong: bool = True,
) -> Ranking:
    """Fit each promising cause on top of a reference and rank them by the BIC.

    Where fits cross, the reference of the result is a better one if fits of causes have led there.

    Args:
        problem: Training windows.
        start: The baseline.
        reference: Fit of the baseline with the causes accepted so far.
        accepted: Those causes.
        hints: Data from which causes choose their start values.
        causes: Causes to try; None tries the whole catalogue.
        limit: Asked before a second round of fits; None allows it.
        worth: Fall of the cost that a cause needs; those that will fall short of it are not fitted to the end.
        wanted: Fall of the BIC from which a cause is named; 0 for a ranking of all causes. Of many parameters, causes
            that slopes keep far from it are not fitted, and there is no second round of fits where slopes tell that
            none can be.
        cross: Whether candidates and reference are also fitted from each other's optimum (:mod:`.crossed`).
        strong: Whether a cause may be so strong that it drives the reference far from the true parameters.
    """
    everything = [*catalogue(problem.system.base).values()] if causes is None else causes
    everything = with_freed_positions(problem, reference, everything)
    names = [c.name for c in accepted]
    tried = [c for c in everything if c.name not in names and c.scatter is None and not c.traced]
    if any(c.effect == "event" for c in accepted):
        tried = [c for c in tried if c.effect != "event"]  # a fit has one push
    # A hundred times slower than the others.
    slow = {e.name for e in problem.system.effects if not problem.system.base.rolls(e.effect)}
    if start.tempering > 1.0:
        # They are told from dry friction by micrometres that a large error hides.
        tried = [c for c in tried if c.effect not in slow]
    listed = [(cause, place) for cause in tried for place in cause.starts(hints.for_cause(cause))]
    slips = [(cause, place) for cause, place in listed if not cause.free]
    prior = prior_with(problem, start, accepted, reference.values)
    tangent = Linearised(problem, reference, prior)
    promises = screen(problem, reference, prior, [pair for pair in listed if pair[0].free], tangent)
    # Of a tempered refit, flexible causes are not fitted, and set no bar.
    barring = [p for p in promises if start.tempering == 1.0 or kind_of(p.cause.name) not in FLEXIBLE_CAUSES]
    least = MIN_OF_BEST_CAUSE * MIN_OF_BEST_START * max(largest_promises(barring).values(), default=0.0)
    promises += cheapest_in_valley(problem, reference, prior, tried, least)
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
        promising = best_of_each_place(without_hopeless_slow(promising, slow, charge), charge)
        if wanted > 0.0:
            # A misfit that a cause explains does not count, but what this unit leaves when nothing is wrong.
            noise = start.least_deflation
            of_noise = {n: noise / spread.deflation * own for n, own in charge.items()}
            promising = within_reach(promising, of_noise, noise * wanted)
    # Parameters that healthy logs freed are already part of the linearisation, so the score test underrates them.
    known, found = set(start.prior.names), {p.cause.name for p in promising}
    underrated = [
        StartPoint(c, {}, WORTH)
        for c in tried
        if c.free and known.intersection(c.free) and c.name not in found and not is_changed(c)
    ]
    promising += underrated

    def from_reference(points: Sequence[StartPoint]) -> list[Trial]:
        values = [{**reference.values, **p.values} for p in points]
        return [
            trial_of(problem, start, accepted, p.cause, own, reference.state, reference)
            for p, own in zip(points, values, strict=True)
        ]

    trials = from_reference(promising)
    # With many parameters, the candidates of a reference share its slopes.
    sharing = many or (bool(trials) and problem.keeps_slopes(trials))
    known = tangent.kept() if sharing else None
    of_slips = slipped(problem, start, accepted, reference, slips, HOPELESS if many else np.inf)
    if sharing:
        fits = fit_best(problem, trials, reference, known)
        fits |= fit_best(problem, of_slips, reference)
        trials += of_slips
    else:
        trials += of_slips
        fits = fit_best(problem, trials, reference, worth=worth)
    # With a tempered prior, the values as given are known to be no place from which anything can be told.
    far_away = strong and start.tempering == 1.0 and strained(problem, start, reference, not accepted)
    if far_away and many:
        # It takes most of the time there. With few parameters it is cheap, and completes the class of the best cause.
        gained = {n: reference.cost - f.cost for n, f in fits.items() if not f.diverged}
        most = {n: max(p, gained.get(n, 0.0)) for n, p in largest_promises(promises).items()}
        best = min([reference, *fits.values()], key=lambda fit: fit.cost)
        far_away = can_gain(start, problem.windows, reference, best, tried, most, wanted)
    if far_away and limit is not None:
        far_away = limit.allows(f"fits of causes from the values as given{in_company_of(names)}")
    given = _as_given(problem, start, reference) if far_away else None
    there = [] if given is None else _screened_there(problem, given, prior, tried, listed, hints)
    if given is not None and (promising or there):
        # A strong cause drives the refit far from the true parameters, and fits return slowly from there. So each
        # cause is also fitted from the baseline's values before the refit, with initial states fitted to each start.
        also = {p.cause.name for p in promising}
        fresh = [p for p in there if p.cause.name not in also]
        effects = list(dict.fromkeys(p.cause.name for p in fresh if not is_changed(p.cause)))
        changes = list(dict.fromkeys(p.cause.name for p in fresh if is_changed(p.cause)))
        asked = {*effects[:MOST_AS_GIVEN], *changes[:MOST_CHANGED]}
        far = [p for p in fresh if p.cause.name in asked]
        if many:
            far = best_of_each_place(without_hopeless_slow(far, slow, charge), charge)
            kept = promising_there(promising, there)
            held = [(p.cause.name, p.values) for p in kept]
            promising = [*kept, *(p for p in underrated if (p.cause.name, p.values) not in held)]
        else:
            held = [(p.cause.name, p.values) for p in promising]
            also_there = [p for p in there if p.cause.searched and p.cause.name in also]
            promising = [*promising, *(p for p in also_there if (p.cause.name, p.values) not in held)]
        pushes = not many or explained_mostly(given, reference)
        from_given = [p for p in (*promising, *far) if pushes or not p.cause.searched]
        values = [{**given.values, **p.values} for p in from_given]
        stuck = {name for name, fit in fits.items() if fit.stuck or fit.diverged}
        known = (
            problem.slopes_at(given.values, reference.free, given.state, reference.nuisance)
            if sharing
            else None
        )
        footholds = [
            trial_of(problem, start, accepted, p.cause, values[k], given.state, reference)
            for k, p in enumerate(from_given)
        ]
        footholds = alone(problem, footholds, from_given, known, ITERATIONS if sharing else ALONE)
        led = {t.name for t in footholds}
        promises += [p for p in far if p.cause.name in led]
        trials += footholds
        # These starts are fitted to the end by themselves: in the first iterations the others look better.
        fits = _lower_ones(fits, fit_best(problem, footholds, reference, known, worth))
        # Where whole windows led to no minimum, another start of the same windows may end in a false one.
        hard = [k for k, p in enumerate(from_given) if p.cause.name in stuck or p.cause.name not in fits]
        if hard and not sharing:
            hard_points, there = [from_given[k] for k in hard], [values[k] for k in hard]
            footholds = from_halves(problem, start, accepted, hard_points, there, reference)
            trials += footholds
            fits = _lower_ones(fits, fit_best(problem, footholds, reference, worth=worth))
    asked = {t.name for t in trials}
    open_ones = [
        p for p in promises if start.tempering == 1.0 or kind_of(p.cause.name) not in FLEXIBLE_CAUSES
    ]
    for _ in range(ROUNDS):
        found = ranked(problem, start, reference, tried, _sound(fits), largest_promises(promises))
        rest = outstanding(found, open_ones, asked, SLOTS * len(problem.windows), wanted)
        rest += simpler_frictions(found, open_ones, {*asked, *(p.cause.name for p in rest)})
        if many:
            rest = best_of_each_place(without_hopeless_slow(rest, slow, charge), charge)
        if not rest or (
            limit is not None and not limit.allows(f"fits of further causes{in_company_of(names)}")
        ):
            break
        asked |= {p.cause.name for p in rest}
        own = from_reference(rest)
        trials += own
        fits |= fit_best(problem, own, reference, tangent.kept() if sharing else None, worth)
    promised = largest_promises(promises)
    unfitted = tuple(name for name, fit in fits.items() if fit.diverged)
    fits = _sound(fits)
    ranking = ranked(problem, start, reference, tried, fits, promised)
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
        longer = [first[n].from_fit(fits[n]) for n in unsettled]
        near = CLOSE * ranking.dispersion.correlation
        fits |= dict(zip(unsettled, problem.fit(longer, PATIENCE, near), strict=True))
        ranking = ranked(problem, start, reference, tried, fits, promised)
    if not many and start.tempering == 1.0 and hides_a_position(problem.windows):
        better, found = with_exchanged_states(problem, start, accepted, ranking)
        won, reference = reference.cost - better.cost, better
        promised = {name: max(p - won, 0.0) for name, p in promised.items()}
        ranking = ranked(problem, start, reference, tried, fits := fits | found, promised)
    crosses = cross and start.tempering == 1.0
    if crosses and (gains_elsewhere(start, ranking) if many else leaves_more(problem, start, ranking)):
        better = better_reference(problem, start, accepted, ranking, 1 if many else FRONT)
        if better is not None and at_another_place(ranking, better):
            return rank(problem, start, better, accepted, hints, causes, limit, worth, wanted, strong=strong)
        if better is not None:
            # What a cause promised beside the old reference, the better one has in part.
            won = reference.cost - better.cost
            promised = {name: max(p - won, 0.0) for name, p in promised.items()}
            reference = better
        if not many:
            fits |= crossed(problem, start, accepted, ranking)
        ranking = ranked(problem, start, reference, tried, fits, promised)
    ranking = with_natural_shapes(problem, start, accepted, ranking)
    return replace(ranking, unfitted=unfitted, beside=tuple(names), asked=tuple(c.name for c in everything))


def _sound(fits: Mapping[str, Fit]) -> dict[str, Fit]:
    """Return the fits that did not diverge."""
    return {name: fit for name, fit in fits.items() if not fit.diverged}


def _lower_ones(fits: Mapping[str, Fit], others: Mapping[str, Fit]) -> dict[str, Fit]:
    """Return the fit of lower cost of each name."""
    return {**fits, **{n: f for n, f in others.items() if n not in fits or f.cost < fits[n].cost}}


def _as_given(problem: FitProblem, start: Baseline, reference: Fit) -> Fit | None:
    """Return the reference with the baseline's values before the refit; None where the simulation diverges there."""
    values = {**reference.values, **{n: start.values[n] for n in start.prior.names}}
    nuisance = reference.nuisance[None]
    states, costs = problem.fit_states_each([values], reference.state[None], nuisance=nuisance)
    if not bool(torch.isfinite(costs).all()):
        return None
    theta, state = np.array([[values[n] for n in problem.names]]), states[0]
    shown = problem.predict(theta, states, nuisance)[0]
    residual = problem.weighed(problem.windows.value - shown)
    return replace(
        reference, values=values, state=state, residual=residual, chi2=float(residual.square().sum())
    )


def _screened_there(
    problem: FitProblem,
    given: Fit,
    prior: Prior,
    tried: Sequence[Cause],
    listed: Sequence[tuple[Cause, Mapping[str, float]]],
    hints: Hints,
) -> list[StartPoint]:
    """Return the promising starts at the baseline's values before the refit.

    Where several parameters together imitate a cause, the refit has moved them there, and the score test at the refit
    sees nothing of it: a payload within a link is another mass and another inertia of it. One parameter that changed
    much moves the others with it in the same way.

    What is missing there is not what the refit misses. A push for some seconds bends all parameters, and what is left
    beside these shows another push, at another time.

    Args:
        problem: The windows.
        given: The simulation there.
        prior: Prior of the refit's parameters.
        tried: Causes.
        listed: Their starts at the refit.
        hints: Data from which these were chosen.
    """
    at_given = Hints(
        hints.system,
        problem.windows,
        missing_torque(problem, given),
        given.chi2 / problem.windows.samples,
        hints.strained,
    )
    pairs = [pair for pair in listed if pair[0].free]
    known = {(cause.name, *sorted(place.items())) for cause, place in pairs}
    for cause in tried:
        for place in cause.starts(at_given.for_cause(cause)) if cause.free else ():
            if (cause.name, *sorted(place.items())) not in known:
                pairs.append((cause, place))
    kept: list[StartPoint] = []
    for point in promising_starts(screen(problem, given, prior, pairs)):
        if point.cause.searched or all(point.cause.name != p.cause.name for p in kept):
            kept.append(point)
    return sorted(kept, key=lambda p: -p.promise)


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
    leads the ranking, the lasting causes that are detected in all windows are ranked again on those that it does not
    touch. One that is detected there, too, and is more than any healthy machine has goes first. The push may follow in
    the next round.
    """
    winner = ranking.best
    if winner.cause.effect != "event":
        return ranking
    windows = problem.windows
    keep = ~touched(windows, winner.fit.values)
    lasting = [c.cause for c in ranking.candidates if c.cause.effect != "event" and c.delta_bic > detection]
    if keep.sum() < MIN_OTHER_WINDOWS or not lasting:
        return ranking
    rest = FitProblem(problem.system, windows.take(keep))
    pick = torch.from_numpy(np.flatnonzero(keep))
    before = Trial(
        "rest",
        ranking.reference.free,
        prior_with(problem, start, accepted, ranking.reference.values),
        {**winner.fit.values, **{n: ranking.reference.values[n] for n in Push.SIZES}},
        winner.fit.state[pick],
        winner.fit.nuisance,
    )
    reference = rest.fit([before])[0]
    if reference.diverged:
        return ranking
    there = rank(rest, start, reference, accepted, hints, lasting, wanted=detection)
    if not there.candidates or there.best.delta_bic <= detection:
        return ranking
    lasts = there.best
    if lasts.fit is not reference and tolerated(rest, start, lasts.cause, lasts.fit, there.deflation):
        return ranking
    name = lasts.cause.name
    first = next(c for c in ranking.candidates if c.cause.name == name)
    others = sorted(
        (c for c in ranking.candidates if c is not first), key=lambda c: c.cause.effect == "event"
    )
    return replace(ranking, candidates=(first, *others))

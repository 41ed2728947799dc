"""Refined ranking: the winner and the candidates close to it are fitted to convergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import CAUSES, Cause, is_changed
from deepkoco.diagnose.evidence.classes import APART, NEAR, equivalent
from deepkoco.diagnose.evidence.coloured import leader_under_colour
from deepkoco.diagnose.evidence.elimination import beyond_chance, held_out_chi2
from deepkoco.diagnose.evidence.footholds import SCOUTING, trial_of
from deepkoco.diagnose.evidence.minor import LEAST_SHARE
from deepkoco.diagnose.evidence.priors import declared, prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, fitted_first, penalty, with_better_fit
from deepkoco.diagnose.evidence.selection import CLOSE, PATIENCE
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE
from deepkoco.fit.solve.scaled_inverse import DivergedError

HOPEFUL = 0.9  # share of what the winner explains, from which a simpler cause is fitted to convergence
SURE = 2.0 * APART  # BIC difference from which a fit that kept the slopes of another point is not repeated
PACE = 8  # iterations that show the pace of a fit
VALLEYS = 8  # largest number of searches along a valley
USUAL_CHANGE = 0.3  # scale of the change of a parameter, as a share of its given value


def front_settled(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], ranking: Ranking, forms: bool = True
) -> Ranking:
    """Fit the winner, and all close candidates that may still improve, to convergence.

    The class depends on BIC differences, so fits that have not converged would give a wrong class. A candidate that
    converges late may even become the winner. A simpler form of the winner is fitted from the winner's optimum too:
    otherwise two minima of the other parameters are compared, and not the two forms.

    Args:
        problem: The windows.
        start: The baseline.
        accepted: Causes that are part of every fit.
        ranking: The ranking.
        forms: Whether simpler forms of the winner are also fitted from its optimum. Small effects of healthy logs
            need no name.
    """
    # Of correlated residuals, a sample decides only so much less.
    near = TOLERANCE * ranking.dispersion.correlation
    winner = _better(ranking.best, settled(problem, start, accepted, ranking.best, near), ranking)
    others = list(ranking.candidates[1:])
    for k, other in enumerate(others):
        # A candidate with a better score than the winner was put behind it on purpose (`without_events_first`).
        behind = ranking.best.delta_bic - other.delta_bic
        if behind < 0.0 or not other.cause.free or other.only_promised(ranking.reference):
            continue
        if forms and _same_family(winner.cause, other.cause) and _simpler(winner, other, 0.0):
            other = others[k] = _from_winner(problem, start, accepted, ranking, other, winner)
            if other.delta_bic > winner.delta_bic:
                winner, others[k] = other, winner
                continue
            behind = ranking.best.delta_bic - other.delta_bic
        if behind - _overpaid(ranking, other) >= NEAR and not _simpler(ranking.best, other, HOPEFUL):
            continue
        sure = other.fit.exact or behind - _overpaid(ranking, other) >= SURE
        if other.fit.converged and sure and not _pulled_back(problem, start, other):
            continue
        others[k] = _better(other, settled(problem, start, accepted, other, near), ranking)
        if others[k].delta_bic > winner.delta_bic:
            winner, others[k] = others[k], winner
    return replace(ranking, candidates=(winner, *others))


def _from_winner(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    ranking: Ranking,
    other: Candidate,
    winner: Candidate,
) -> Candidate:
    """Fit a candidate from the parameters and initial states of the winner, and keep the better of its fits.

    A fit that comes neither near the winner nor explains most of what that explains would change nothing. It ends
    where it would not reach this at its present pace.
    """
    null = {n: start.values[n] for n in winner.cause.free}
    own = {n: other.fit.values[n] for n in other.cause.free}
    values = {**winner.fit.values, **null, **own}
    trial = trial_of(problem, start, accepted, other.cause, values, winner.fit.state, ranking.reference)
    close = TOLERANCE * ranking.dispersion.correlation
    fit = problem.fit([trial], PACE, close)[0]
    charge = other.likelihood_ratio / ranking.deflation - other.delta_bic
    near = (winner.delta_bic - NEAR + charge) * ranking.deflation
    missing = fit.cost - ranking.reference.cost + min(near, HOPEFUL * winner.likelihood_ratio)
    ended = fit.converged or fit.diverged
    lately = fit.history[len(fit.history) // 2 :]
    if not ended and missing < (lately[0] - lately[-1]) * (PATIENCE - PACE) / max(len(lately) - 1, 1):
        trial = trial.from_fit(fit)
        fit = problem.fit([trial], PATIENCE - PACE, close)[0]
    return with_better_fit(other, fit, ranking.deflation)


def _overpaid(ranking: Ranking, other: Candidate) -> float:
    """Return the penalty of the prior of a candidate above that of the winner, as a difference of BIC.

    It applies where the winner has no free parameter, as a unit slip. A gain of the same size has the narrow prior of
    small gains. It is behind by this penalty until it is fitted with a wider prior.
    """
    if ranking.best.cause.free:
        return 0.0
    return max(other.fit.penalty - ranking.best.fit.penalty, 0.0) / ranking.deflation


def classed(
    problem: FitProblem,
    start: Baseline,
    ranking: Ranking,
    accepted: Sequence[Cause],
    held: Windows | None = None,
) -> tuple[Ranking, tuple[str, ...]]:
    """Return the ranking and the names of its winner's class, the simpler cause and the mechanism first.

    Where a model error is left, a cause with more parameters must explain clearly more than a simpler one: below
    ``LEAST_SHARE`` of the whole, it only describes the form of the simpler one. Dry friction is an example, of which a
    log shows some excess near standstill. A simpler cause of its own family and class leads, too, unless the error in
    held-out windows is larger with it: a model error can favour the one or the other form in the windows that are
    fitted. Where only noise is left, a simpler cause of its family that explains as much leads unless the BIC tells
    them apart: the breakaway of a dry friction is then too small to be told from none.

    Args:
        problem: The windows.
        start: The baseline.
        ranking: The ranking, its winner and the candidates close to it fitted to convergence.
        accepted: Causes that are part of every fit.
        held: Held-out windows; None where there are none.

    Almost every mechanism can be written as another value of some parameter. Where the data cannot distinguish the
    two, the mechanism leads the class. The farther the parameter is from its given value, the more evidence it needs.
    Among parameters, the one leads whose change its declared uncertainty makes most likely.
    """
    fitted = [c for c in ranking.candidates[1:] if not c.only_promised(ranking.reference)]
    simple = [c for c in fitted if _simpler(ranking.best, c, 1.0 - LEAST_SHARE)]
    left = ranking.best.fit.chi2 / problem.windows.samples > start.most_noise(problem.windows)
    if not left:
        # Noise favours the form with a shape by as much as two causes need to be distinguished.
        behind = {c.cause.name: ranking.best.delta_bic - c.delta_bic for c in simple}
        simple = [
            c for c in simple if behind[c.cause.name] < APART and _same_family(ranking.best.cause, c.cause)
        ]
    if simple:
        first = min(simple, key=lambda c: (c.cause.size, -c.delta_bic))
        ranking = replace(ranking, candidates=(first, *(c for c in ranking.candidates if c is not first)))
    members = equivalent(problem, start, ranking, tuple(accepted))
    if left and held is not None and len(held):
        form = _simpler_form(problem, start, ranking, members, held)
        if form is not None:
            ranking = replace(ranking, candidates=(form, *(c for c in ranking.candidates if c is not form)))
            members = equivalent(problem, start, ranking, tuple(accepted))
    if left and start.tempering == 1.0 and len(members) > 1:
        clear = leader_under_colour(problem, start, ranking, members, accepted)
        if clear is not None:
            others = (c for c in ranking.candidates if c.cause is not clear.cause)
            ranking = replace(ranking, candidates=(clear, *others))
            members = equivalent(problem, start, ranking, tuple(accepted))
    best = ranking.best
    if not is_changed(best.cause):
        return ranking, members
    least = APART + _size_charge(problem, best)
    near = []
    for c in ranking.candidates[1:]:
        behind = best.delta_bic - c.delta_bic
        if not is_changed(c.cause) and behind < least and (c.cause.name in members or behind >= APART):
            near.append(c)
    first = near[0] if near else _least_surprising(start, ranking, members)
    if first is best:
        return ranking, members
    others = [c for c in ranking.candidates if c is not first]
    ranking = replace(ranking, candidates=(first, *others))
    return ranking, equivalent(problem, start, ranking, tuple(accepted))


def _least_surprising(start: Baseline, ranking: Ranking, members: Sequence[str]) -> Candidate:
    """Return the changed parameter of the class that its declared uncertainty makes most likely.

    A parameter that is known to 2 % is less likely to be wrong by 70 % than one that is known to 20 % is by 100 %. Both
    have wide priors in their fits, so the fits do not tell. The prior of a change is a Cauchy distribution here too;
    its scale is the standard deviation of the baseline's prior.
    """
    spread = dict(zip(start.prior.names, np.sqrt(start.prior.covariance.diagonal()), strict=True))

    def likely(candidate: Candidate) -> float:
        charge = 0.0
        for name in candidate.cause.free:
            far = (candidate.fit.values[name] - start.values[name]) / spread[name]
            charge += 2.0 * math.log1p(far**2)
        return candidate.delta_bic - charge

    changes = [
        c
        for c in ranking.candidates
        if c.cause.name in members
        and c.fit is not ranking.reference
        and is_changed(c.cause)
        and spread.keys() >= {*c.cause.free}
    ]
    return max(changes, key=likely, default=ranking.best)


def _simpler(best: Candidate, other: Candidate, least: float) -> bool:
    """Return whether a lasting mechanism has fewer parameters and explains at least a share of what the best does."""
    if not other.cause.free or is_changed(other.cause) or other.cause.effect == "event":
        return False
    return other.cause.size < best.cause.size and other.likelihood_ratio >= least * best.likelihood_ratio


def _simpler_form(
    problem: FitProblem, start: Baseline, ranking: Ranking, members: Sequence[str], held: Windows
) -> Candidate | None:
    """Return the simplest member of the winner's class and family that held-out windows do not speak against."""
    best = ranking.best
    forms = [
        c
        for c in ranking.candidates[1:]
        if c.cause.name in members
        and c.fit is not ranking.reference
        and _same_family(best.cause, c.cause)
        and _simpler(best, c, 0.0)
    ]
    if not forms:
        return None
    try:
        errors = held_out_chi2(problem, start, best.fit, held)
        for form in sorted(forms, key=lambda c: (c.cause.size, -c.delta_bic)):
            if not beyond_chance(held_out_chi2(problem, start, form.fit, held) - errors):
                return form
    except DivergedError:
        pass  # then the held-out windows decide nothing
    return None


def _same_family(cause: Cause, other: Cause) -> bool:
    """Return whether two causes are of one family and act at one place."""
    place = (cause.joint, cause.index) == (other.joint, other.index)
    return place and CAUSES[cause.kind].family == CAUSES[other.kind].family


def _size_charge(problem: FitProblem, candidate: Candidate) -> float:
    """Return the charge for the size of a changed parameter, as a difference of BIC: 2 log(1 + (change / scale)^2).

    The prior of a change is a Cauchy distribution. Its scale is USUAL_CHANGE of the given value, or the prior standard
    deviation of a parameter that is given as 0.
    """
    charge = 0.0
    for name in candidate.cause.free:
        given = problem.system.parameter(name)
        scale = USUAL_CHANGE * abs(given.value) or given.prior_sd
        charge += 2.0 * math.log1p(((candidate.fit.values[name] - given.value) / scale) ** 2)
    return charge


def with_fit(problem: FitProblem, start: Baseline, ranking: Ranking, cause: Cause, fit: Fit) -> Ranking:
    """Return a ranking in which a cause has this fit, if it had none or a worse one.

    Where the fit is better than all that made the ranking, its residuals are the noise by which everything counts.

    Args:
        problem: The windows.
        start: The baseline.
        ranking: The ranking.
        cause: The cause.
        fit: Its fit, on top of the ranking's reference.
    """
    own = next((c for c in ranking.candidates if c.cause.name == cause.name), None)
    if own is not None and own.fit is not ranking.reference and own.fit.cost <= fit.cost:
        return ranking
    lowest = min([ranking.reference.cost, *(c.fit.cost for c in ranking.candidates)])
    if fit.cost < lowest:
        spread = dispersion(fit, problem.windows)
        ranking = replace(
            ranking,
            dispersion=spread,
            deflation=max(spread.deflation, start.least_deflation),
            samples=problem.windows.samples / spread.correlation,
        )
    mine = Candidate(cause, fit, ranking.reference.cost - fit.cost, 0.0)
    others = [c for c in ranking.candidates if c is not own]

    def scored(candidate: Candidate) -> Candidate:
        charge = penalty(candidate.cause, ranking.samples, SLOTS * len(problem.windows))
        return replace(candidate, delta_bic=candidate.likelihood_ratio / ranking.deflation - charge)

    return replace(ranking, candidates=fitted_first(map(scored, [*others, mine]), ranking.reference))


def _pulled_back(problem: FitProblem, start: Baseline, candidate: Candidate) -> bool:
    """Return whether the declared prior, which is meant for small effects, pulls a large estimate towards null.

    The winner was refitted with a wider prior, so such a candidate must be refitted in the same way.
    """
    return any(
        abs(candidate.fit.values[p.name] - start.values[p.name]) > p.prior_sd
        for p in declared(problem, candidate.cause.free)
    )


def _better(candidate: Candidate, fit: Fit, ranking: Ranking) -> Candidate:
    won = candidate.fit.cost - fit.cost
    return replace(
        candidate,
        fit=fit,
        likelihood_ratio=candidate.likelihood_ratio + won,
        delta_bic=candidate.delta_bic + won / ranking.deflation,
    )


def settled(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    winner: Candidate,
    tolerance: float = TOLERANCE,
) -> Fit:
    """Fit a winner to convergence. Otherwise its remaining misfit would look like a further cause."""
    fit = winner.fit
    prior = prior_with(problem, start, [*accepted, winner.cause], fit.values)
    if not set(fit.free) <= set(prior.names):
        return fit
    trial = Trial(fit.name, fit.free, prior, fit.values, fit.state, fit.nuisance)
    if winner.cause.valley is None:
        found = problem.fit([trial], PATIENCE, tolerance)[0]
        return fit if found.diverged else found
    for _ in range(VALLEYS):
        # A fit takes short steps in a narrow valley of the cost, so new starts are placed along the valley.
        along = [
            trial,
            *(replace(trial, values={**trial.values, **v}) for v in winner.cause.valley(trial.values)),
        ]
        fits = problem.fit(along, SCOUTING, CLOSE)
        found = min(fits, key=lambda f: f.cost)
        won = fit.cost - found.cost
        if won > 0.0:
            fit, trial = found, trial.from_fit(found)
        if won < CLOSE:
            break
        if found is fits[0]:
            # No other start of the valley is better: the rest is a matter of a few steps.
            found = problem.fit([trial], PATIENCE, tolerance)[0]
            fit = found if found.cost < fit.cost else fit
            break
    return fit

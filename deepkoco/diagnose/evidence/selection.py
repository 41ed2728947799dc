"""Fit every cause of the catalogue, rank them, and decide which are there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, catalogue
from deepkoco.diagnose.evidence.event_windows import MIN_OTHER_WINDOWS, touched
from deepkoco.diagnose.evidence.screening import StartPoint as Promise
from deepkoco.diagnose.evidence.screening import screen
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.residuals.residuals import SLOTS, Dispersion, dispersion
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import Parameter

# Fall of the BIC that a first cause must reach, and each further one. Calibrated on logs of units in
# which nothing is wrong (results/diagnose/), on other seeds than the tests use.
DETECTION = 24.0
FURTHER = 30.0
SCOUTING = 4  # iterations after which only the best start of each cause goes on
PROMISING_SHARE = 0.3  # share of the best start's gain that a candidate must have by then to go on
ITERATIONS = 14
PATIENCE = 40  # further iterations for a winner that has not converged
WORTH = 8.0  # fall of the cost, to first order, from which a cause is worth a fit of its own
SLIPS = 4  # constants between units that are fitted in full
SLIP_ITERATIONS = 6
SHARE = 0.2  # or this share of what the most promising one offers
ABREAST = 0.3  # share of a cause's best promise that its further starts must have
STARTS = 3  # of one cause, at most
CLOSE = 0.2  # fall of the cost per iteration below which a candidate has converged
FAR = 25.0  # prior penalty of a refit that a strong cause has driven away


@dataclass(frozen=True)
class Candidate:
    """One cause, fitted together with the baseline's parameters.

    Attributes:
        cause: The cause.
        fit: Its fit; never worse than the reference that it extends.
        likelihood_ratio: Fall of the cost against the reference, under white noise.
        delta_bic: Fall of the BIC against the reference, after deflation; above 0 it pays.
    """

    cause: Cause
    fit: Fit
    likelihood_ratio: float
    delta_bic: float


@dataclass(frozen=True)
class Ranking:
    """Candidates from best to worst, and the yardstick they were measured with."""

    reference: Fit
    candidates: tuple[Candidate, ...]
    dispersion: Dispersion
    deflation: float
    samples: float  # effective number of samples
    unfitted: tuple[str, ...] = ()  # causes at every start of which the simulation diverges

    @property
    def best(self) -> Candidate:
        """The candidate whose BIC falls most."""
        return self.candidates[0]

    def probabilities(self) -> dict[str, float]:
        """Weight of each candidate among all and the reference, exp(delta BIC / 2) normalised."""
        score = np.array([0.0] + [c.delta_bic for c in self.candidates])
        weight = np.exp(0.5 * (score - score.max()))
        return dict(zip([c.cause.name for c in self.candidates], weight[1:] / weight.sum(), strict=True))


def penalty(cause: Cause, samples: float, places: int) -> float:
    """What the BIC charges for a cause that was searched for at ``places`` places."""
    charge = cause.size * math.log(max(samples, 2.0))
    # Once for the places that were tried, and once more because any one window may be spoiled by model
    # error, which a push can mend and which the other windows do not speak against.
    charge += 2.0 * math.log(cause.choices)
    return charge + (4.0 * math.log(max(places, 1)) if cause.searched else 0.0)


def declared(problem: FitProblem, names: Sequence[str]) -> list[Parameter]:
    """Declarations of parameters, pushes included, by full name."""
    pushes = Push.declared(problem.system, problem.windows)
    return [pushes[n] if n in pushes else problem.system.parameter(n) for n in names]


def prior_with(
    problem: FitProblem, start: Baseline, causes: Sequence[Cause], values: Mapping[str, float]
) -> Prior:
    """The baseline's prior, widened by what the causes free.

    A cause's spread is at least as wide as its value has come from null: the declared one, for small effects, would
    pull a large one back, and what that lacks would pass for a further cause.
    """
    prior = start.prior
    for cause in causes:
        # What only chooses a shape or a place has no null: its prior is around where the search found it.
        shapes = {*Push.NAMES[1:3], f"{cause.effect}.frequency"}
        centre = {n: values[n] if n in shapes else start.values[n] for n in cause.free}
        own = [
            replace(p, prior_sd=max(p.prior_sd, abs(values[p.name] - centre[p.name])))
            for p in declared(problem, cause.free)
        ]
        prior = prior.widened(own, centre)
    return prior


def freed(
    problem: FitProblem, before: Baseline, causes: Sequence[Cause], fit: Fit, values: Mapping[str, float]
) -> Trial:
    """Everything free that a baseline has and these causes free, from a fit of the same windows."""
    prior = prior_with(problem, before, causes, values)
    return Trial("healthy", prior.names, prior, values, fit.state, fit.nuisance)


def strained(problem: FitProblem, start: Baseline, fit: Fit) -> bool:
    """Whether a fit has left its prior by far, as a strong cause or a wrong unit makes it."""
    away = fit.penalty - problem.nuisances.penalty(fit.nuisance)
    return away > FAR * start.correlation


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
        hints: What causes look at for their start values.
        causes: Causes to try; None tries the whole catalogue.
    """
    everything = catalogue(problem.system.base).values() if causes is None else causes
    names = {c.name for c in accepted}
    tried = [c for c in everything if c.name not in names and c.scatter is None and not c.traced]
    listed = [(cause, place) for cause in tried for place in cause.starts(hints.for_cause(cause))]
    slips = [(cause, place) for cause, place in listed if not cause.free]
    prior = prior_with(problem, start, accepted, reference.values)
    promises = screen(problem, reference, prior, [pair for pair in listed if pair[0].free])
    promising = _promising(promises)
    # Parameters that a healthy log freed are in the tangent already, which hides what more of them would win.
    known, found = set(start.prior.names), {p.cause.name for p in promising}
    promising += [
        Promise(c, {}, WORTH) for c in tried if c.free and known.intersection(c.free) and c.name not in found
    ]
    trials = [
        _trial(
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
    trials += _slipped(problem, start, accepted, reference, slips)
    fits = _fit_best(problem, trials, reference)
    if strained(problem, start, reference) and promising:
        # A strong cause drives the refit far from the truth, into a valley that leads back slowly. The
        # baseline's values before the refit are a second foothold, with states that suit each start.
        before = {n: start.values[n] for n in start.prior.names}
        values = [{**reference.values, **before, **p.values} for p in promising]
        states, costs = problem.fit_states_each(values, reference.state.repeat(len(values), 1, 1))
        free = {p.cause.name: p.cause.free for p in promising}
        footholds = [
            _trial(problem, start, accepted, p.cause, values[k], states[k], reference)
            for k, p in enumerate(promising)
            if bool(torch.isfinite(costs[k]).all())
        ]
        # First each cause alone, before the baseline may give way to it as it did in the refit.
        alone = problem.fit([replace(t, free=tuple(free[t.name])) for t in footholds], ITERATIONS, CLOSE)
        footholds = [
            replace(t, values=fit.values, state=fit.state, nuisance=fit.nuisance)
            for t, fit in zip(footholds, alone, strict=True)
        ]
        # Each foothold goes its own way to the end: the valley looks better for the first few iterations.
        for name, fit in _fit_best(problem, footholds, reference).items():
            if name not in fits or fit.cost < fits[name].cost:
                fits[name] = fit
    promised = _best(promises)
    unfitted = tuple(name for name, fit in fits.items() if fit.diverged)
    fits = {name: fit for name, fit in fits.items() if not fit.diverged}
    ranking = _ranked(problem, start, reference, tried, fits, promised)
    # What is left of a winner that has not converged would pass for a further cause; and what promised more than
    # the winner won may only be slow.
    best = ranking.best.cause.name if ranking.candidates else ""
    won = reference.cost - min((fit.cost for fit in fits.values()), default=reference.cost)
    unsettled = [n for n, f in fits.items() if not f.converged and (n == best or promised.get(n, 0.0) > won)]
    if unsettled:
        first = {name: next(t for t in trials if t.name == name) for name in unsettled}
        longer = [
            replace(first[n], values=fits[n].values, state=fits[n].state, nuisance=fits[n].nuisance)
            for n in unsettled
        ]
        fits |= dict(zip(unsettled, problem.fit(longer, PATIENCE, CLOSE), strict=True))
        ranking = _ranked(problem, start, reference, tried, fits, promised)
    return replace(ranking, unfitted=unfitted)


def _fit_best(problem: FitProblem, trials: Sequence[Trial], reference: Fit) -> dict[str, Fit]:
    """Fit of each name: a few iterations of every trial, then the better half of the way of the best ones."""
    if not trials:
        return {}
    scouts = problem.fit(trials, SCOUTING, CLOSE)
    best: dict[str, tuple[Fit, Trial]] = {}
    for trial, scout in zip(trials, scouts, strict=True):
        if trial.name not in best or scout.cost < best[trial.name][0].cost:
            best[trial.name] = (scout, trial)
    won = reference.cost - min(scout.cost for scout, _ in best.values())
    longer, running = [], []
    for name, (scout, trial) in best.items():
        # One that is far behind stays where it is: it would not get to the front.
        if not scout.converged and reference.cost - scout.cost > PROMISING_SHARE * won:
            running.append(name)
            longer.append(replace(trial, values=scout.values, state=scout.state, nuisance=scout.nuisance))
    longer = problem.fit(longer, ITERATIONS, CLOSE)
    return {name: scout for name, (scout, _) in best.items()} | dict(zip(running, longer, strict=True))


def _best(promises: Sequence[Promise]) -> dict[str, float]:
    """Best promise of each cause."""
    result: dict[str, float] = {}
    for p in promises:
        result[p.cause.name] = max(result.get(p.cause.name, 0.0), p.promise)
    return result


def _promising(promises: Sequence[Promise]) -> list[Promise]:
    """Starts that are worth a fit: of the causes that promise much, those that promise it."""
    best = _best(promises)
    bar = max(WORTH, SHARE * max(best.values(), default=0.0))
    kept: dict[str, list[Promise]] = {}
    for p in sorted(promises, key=lambda p: -p.promise):
        own = kept.setdefault(p.cause.name, [])
        enough = best[p.cause.name] >= bar and p.promise >= ABREAST * best[p.cause.name]
        if enough and len(own) < STARTS:
            own.append(p)
    return [p for own in kept.values() for p in own]


def _slipped(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    reference: Fit,
    slips: Sequence[tuple[Cause, Mapping[str, float]]],
) -> list[Trial]:
    """Trials of constants between units: far from the refit, with the baseline as it was before."""
    if not slips:
        return []
    before = {n: start.values[n] for n in start.prior.names}
    values = [{**reference.values, **before, **place} for _, place in slips]
    states = problem.windows.state.repeat(len(slips), 1, 1)
    for k, (cause, place) in enumerate(slips):
        if cause.kind == "channel_slip":
            states[k, :, problem.windows.shows[cause.index]] /= next(iter(place.values()))
    fitted, costs = problem.fit_states_each(values, states, SLIP_ITERATIONS)
    total = costs.sum(-1).nan_to_num(torch.inf)
    # Of many constants only the few that come near the data are worth a fit.
    return [
        _trial(problem, start, accepted, slips[k][0], values[k], fitted[k], reference)
        for k in total.argsort()[:SLIPS].tolist()
        if bool(torch.isfinite(total[k]))
    ]


def _trial(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    cause: Cause,
    values: Mapping[str, float],
    state: torch.Tensor,
    reference: Fit,
) -> Trial:
    prior = prior_with(problem, start, [*accepted, cause], values)
    return Trial(cause.name, prior.names, prior, values, state, reference.nuisance)


def without_events_first(
    problem: FitProblem,
    start: Baseline,
    ranking: Ranking,
    accepted: Sequence[Cause],
    hints: Hints,
    detection: float,
) -> Ranking:
    """Put a lasting cause before an event, if it shows where the event is not.

    One window that a model fits badly can outweigh all others, and a push can mend any single window. So
    when an event leads, the windows that it touches are masked and the others are ranked again: a cause
    that is detected there acts all the time and goes first; the event may follow in the next round.
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
            continue  # it had nothing to start from
        # What promised little was not fitted and stands with its promise, which is below every fit's.
        fit = fits.get(cause.name, reference)
        ratio = reference.cost - fit.cost if cause.name in fits else promises.get(cause.name, 0.0)
        if ratio < 0.0:
            # The null value is one of its values: where no start finds better, it stays there.
            fit, ratio = reference, 0.0
        score = ratio / deflation - penalty(cause, samples, places)
        candidates.append(Candidate(cause, fit, ratio, float(score)))
    candidates.sort(key=lambda c: -c.delta_bic)
    return Ranking(reference, tuple(candidates), spread, deflation, samples)

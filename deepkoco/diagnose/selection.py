"""Fit every cause of the catalogue, rank them, and decide which are there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Start
from deepkoco.diagnose.causes import CAUSES, Cause, Hint
from deepkoco.diagnose.residuals import SLOTS, Dispersion, MissingTorque, dispersion
from deepkoco.identify.fit import Fit, FitProblem, Trial
from deepkoco.identify.prior import Prior
from deepkoco.identify.push import Push
from deepkoco.systems import Parameter

# Fall of the BIC that a first cause must reach, and each further one. Calibrated on logs of units in
# which nothing is wrong (results/diagnose/), on other seeds than the tests use.
DETECTION = 24.0
FURTHER = 30.0
SCOUTING = 4  # iterations after which only the best start of each cause goes on
HOPE = 0.3  # share of the best start's gain that a candidate must have by then to go on
ITERATIONS = 14
PATIENCE = 40  # further iterations for a winner that has not converged
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
    return charge + (4.0 * math.log(max(places, 1)) if cause.searched else 0.0)


def declared(problem: FitProblem, names: Sequence[str]) -> list[Parameter]:
    """Declarations of parameters, pushes included, by full name."""
    pushes = Push.declared(problem.system, problem.windows)
    return [pushes[n] if n in pushes else problem.system.parameter(n) for n in names]


def prior_with(
    problem: FitProblem, start: Start, causes: Sequence[Cause], values: Mapping[str, float]
) -> Prior:
    """The baseline's prior, widened by what the causes free."""
    prior = start.prior
    for cause in causes:
        centre = {n: values[n] if n in Push.NAMES[1:3] else start.values[n] for n in cause.free}
        prior = prior.widened(declared(problem, cause.free), centre)
    return prior


def rank(
    problem: FitProblem,
    start: Start,
    reference: Fit,
    accepted: Sequence[Cause],
    hint: Hint,
    causes: Sequence[Cause] | None = None,
) -> Ranking:
    """Fit each cause on top of a reference and rank them by the BIC.

    Args:
        problem: Training windows.
        start: The baseline.
        reference: Fit of the baseline with the causes accepted so far.
        accepted: Those causes.
        hint: What causes look at for their start values.
        causes: Causes to try; None tries the whole catalogue.
    """
    tried = [c for c in (causes or CAUSES.values()) if c not in accepted]
    starts = [(cause, place) for cause in tried for place in cause.starts(hint)]
    trials = [
        _trial(problem, start, accepted, cause, {**reference.values, **place}, reference.state, reference)
        for cause, place in starts
    ]
    if reference.penalty > FAR:
        # A strong cause drives the refit far from the truth, into a valley that leads back slowly. The
        # baseline's values before the refit are a second foothold, with states that suit each start.
        before = {n: start.values[n] for n in start.prior.names}
        values = [{**reference.values, **before, **place} for _, place in starts]
        states, costs = problem.fit_states_each(values, reference.state.repeat(len(starts), 1, 1))
        trials += [
            _trial(problem, start, accepted, cause, values[k], states[k], reference)
            for k, (cause, _) in enumerate(starts)
            if bool(torch.isfinite(costs[k]).all())
        ]
    scouts = problem.fit(trials, SCOUTING)
    best: dict[str, tuple[Fit, Trial]] = {}
    for trial, scout in zip(trials, scouts, strict=True):
        if trial.name not in best or scout.cost < best[trial.name][0].cost:
            best[trial.name] = (scout, trial)
    won = reference.cost - min(scout.cost for scout, _ in best.values())
    longer, running = [], []
    for name, (scout, trial) in best.items():
        # One that is far behind stays where it is: it would not get to the front.
        if not scout.converged and reference.cost - scout.cost > HOPE * won:
            running.append(name)
            longer.append(replace(trial, values=scout.values, state=scout.state, zero=scout.zero))
    longer = problem.fit(longer, ITERATIONS)
    fits = {name: scout for name, (scout, _) in best.items()} | dict(zip(running, longer, strict=True))
    ranking = _ranked(problem, start, reference, tried, fits)
    name = ranking.best.cause.name if ranking.candidates else ""
    if name in fits and not fits[name].converged:
        # What is left of a winner that has not converged would pass for a further cause.
        fit = fits[name]
        trial = replace(best[name][1], values=fit.values, state=fit.state, zero=fit.zero)
        fits[name] = problem.fit([trial], PATIENCE)[0]
        ranking = _ranked(problem, start, reference, tried, fits)
    return ranking


def _trial(
    problem: FitProblem,
    start: Start,
    accepted: Sequence[Cause],
    cause: Cause,
    values: Mapping[str, float],
    state: torch.Tensor,
    reference: Fit,
) -> Trial:
    prior = prior_with(problem, start, [*accepted, cause], values)
    return Trial(cause.name, prior.names, prior, values, state, reference.zero)


def without_events_first(
    problem: FitProblem,
    start: Start,
    ranking: Ranking,
    accepted: Sequence[Cause],
    hint: Hint,
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
    begin = winner.fit.values["event.start"]
    end = begin + winner.fit.values["event.duration"]
    touched = (windows.log == winner.fit.values["event.log"]) & (windows.t0 < end)
    touched &= windows.t0 + windows.length > begin
    keep = ~touched
    if keep.sum() < 3:
        return ranking
    rest = FitProblem(problem.system, windows.take(keep))
    pick = torch.from_numpy(np.flatnonzero(keep))
    before = Trial(
        "rest",
        ranking.reference.free,
        prior_with(problem, start, accepted, ranking.reference.values),
        {**winner.fit.values, "event.torque": ranking.reference.values["event.torque"]},
        winner.fit.state[pick],
        winner.fit.zero,
    )
    reference = rest.fit([before])[0]
    lasting = [c.cause for c in ranking.candidates if c.cause.effect != "event"]
    there = rank(rest, start, reference, accepted, hint, lasting)
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
    problem: FitProblem, start: Start, reference: Fit, tried: Sequence[Cause], fits: Mapping[str, Fit]
) -> Ranking:
    lowest = min([reference, *fits.values()], key=lambda fit: fit.cost)
    spread = dispersion(lowest, problem.windows)
    deflation = max(spread.deflation, start.floor)
    samples = problem.windows.samples / spread.correlation
    places = SLOTS * len(problem.windows)
    candidates = []
    for cause in tried:
        if cause.name not in fits:
            continue
        fit = fits[cause.name]
        ratio = reference.cost - fit.cost
        if ratio < 0.0:
            # The null value is one of its values: where no start finds better, it stays there.
            fit, ratio = reference, 0.0
        score = ratio / deflation - penalty(cause, samples, places)
        candidates.append(Candidate(cause, fit, ratio, float(score)))
    candidates.sort(key=lambda c: -c.delta_bic)
    return Ranking(reference, tuple(candidates), spread, deflation, samples)


def pushes_from(missing: MissingTorque) -> tuple[dict[str, float], ...]:
    """Starts of a push: the slots (and runs of slots) where an outside torque would help most."""
    found = []
    for width in (1, 3):
        score = np.lib.stride_tricks.sliding_window_view(missing.score, width, axis=1).sum(-1)
        w, k = np.unravel_index(int(np.argmax(score)), score.shape)
        found.append(
            {
                "event.torque": float(missing.single[w, k : k + width].mean()) / width,
                "event.start": float(missing.time[w, k] - 0.5 * missing.slot),
                "event.duration": width * missing.slot,
                "event.log": float(missing.log[w]),
            }
        )
    return tuple(found)

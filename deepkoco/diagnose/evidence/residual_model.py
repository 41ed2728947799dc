"""A learned load for what nothing in the catalogue explains: sparse regression on simulation errors.

Terms in angle, speed and effort are added one by one: the one whose weight promises most by the score test, refitted
with all others and with the baseline's parameters by multiple shooting. How many are kept is decided on windows of
the training data that this fit does not see; those that later ones made idle are dropped. Whether the whole is kept
is decided on the held-out windows.

Source: forward selection, Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 3.3.2; the score test
    as in :mod:`deepkoco.diagnose.evidence.screening`. The library of terms is in the spirit of Brunton, Proctor, Kutz,
    PNAS 113(15), 2016 (SINDy), but the regression is on simulated trajectories, not on derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.screening import screen
from deepkoco.diagnose.evidence.selection import WORTH, prior_with
from deepkoco.diagnose.gain import Gain, held_out_gain
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.fit.data.windows import STANDSTILL, Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.systems.effects import EFFECTS, place
from deepkoco.systems.effects.learned import SCALES, is_spring

MOST_TERMS = 6
VALIDATED = 4  # one training window in four decides how many terms are kept
MIN_MODEL_WINDOWS = 6
BETTER = 0.99  # validation error against the one before, below which a term is worth keeping
PATIENCE = 2  # terms in a row that may fail to improve it
ITERATIONS = 12
LEAST_WEIGHT = 2.0  # standard deviations, below which a term is idle beside those found later


@dataclass(frozen=True)
class Term:
    """One learned term.

    Attributes:
        name: Full name of its weight.
        weight: Value.
        sd: Its standard deviation.
        unit: Of the weight.
    """

    name: str
    weight: float
    sd: float
    unit: str


@dataclass(frozen=True)
class ResidualModel:
    """A learned load and what it is worth.

    Attributes:
        accepted: Whether it lowers the held-out error; only then it belongs into the simulation.
        reason: Why, or why not.
        terms: Its terms in the order in which they were found.
        fit: Fit on all training windows.
        gain: Held-out errors with it as "extended"; None without held-out windows or terms.
        validation: Terms -> chi2 per sample on the windows that chose their number.
        before: chi2 per sample of the refit on the training windows.
        after: The same with the terms.
    """

    accepted: bool
    reason: str
    terms: tuple[Term, ...]
    fit: Fit
    gain: Gain | None
    validation: tuple[float, ...]
    before: float
    after: float

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that carry the terms."""
        return tuple(dict.fromkeys(t.name.rsplit(".", 1)[0] for t in self.terms))

    def to_json(self) -> dict[str, Any]:
        """For report.json."""
        gain = self.gain
        return {
            "accepted": self.accepted,
            "reason": self.reason,
            "terms": [vars(t) for t in self.terms],
            "chi2_per_sample_before": self.before,
            "chi2_per_sample_after": self.after,
            "validation_chi2_per_sample": list(self.validation),
            "reduction_vs_refit": None if gain is None else gain.reduction,
            "low": None if gain is None else gain.low,
            "high": None if gain is None else gain.high,
        }


def learn_residual(
    start: Baseline,
    train: Windows,
    held: Windows | None,
    reference: Fit,
    missing: Sequence[MissingTorque],
    seed: int,
) -> ResidualModel | None:
    """Fit a learned load on top of a refitted baseline.

    Args:
        start: The baseline.
        train: Training windows.
        held: Held-out windows, which decide whether it is accepted.
        reference: The refitted baseline on the training windows.
        missing: Load that the refit misses at each joint, which gives the ranges of angles and speeds.
        seed: Of the bootstrap.

    Returns:
        None where there are too few windows to choose terms.
    """
    if len(train) < MIN_MODEL_WINDOWS:
        return None
    system = start.system
    scaled = {**reference.values, **_scales(start, train, missing)}
    choose = np.arange(len(train)) % VALIDATED == VALIDATED - 2
    offered = [
        c for c in _candidates(start) if not (is_spring(c.name) and c.joint in _resting(train, missing))
    ]
    names, validation = _choose(start, train, choose, reference, scaled, offered)
    problem = FitProblem(system, train)
    before = reference.chi2 / train.samples
    if not names:
        text = "no term in angle, speed and effort lowers the error on windows that it was not fitted to"
        return ResidualModel(False, text, (), reference, None, validation, before, before)
    fit, terms = _without_idle_terms(problem, start, scaled, names, reference)
    after = fit.chi2 / train.samples
    if held is None or len(held) == 0:
        text = "no held-out windows are there to judge it by"
        return ResidualModel(False, text, terms, fit, None, validation, before, after)
    quiet = {"event.torque": 0.0}
    models = {
        "baseline": start.values,
        "refit": {**reference.values, **quiet},
        "extended": {**fit.values, **quiet},
    }
    windows = {
        "baseline": replace(held, varies={}),
        "refit": problem.elsewhere(held, reference),
        "extended": problem.elsewhere(held, fit),
    }
    gain = held_out_gain(system, windows, models, seed)
    if gain is None:
        text = "the simulation diverges on the held-out windows that are to judge it"
        return ResidualModel(False, text, terms, fit, None, validation, before, after)
    accepted = gain.low > 0.0
    span = f"{100 * gain.reduction:.0f} % ({100 * gain.low:.0f} to {100 * gain.high:.0f} %)"
    text = (
        f"it lowers the held-out error by {span}"
        if accepted
        else f"its held-out gain is {span}, which may be none"
    )
    return ResidualModel(accepted, text, terms, fit, gain, validation, before, after)


def _scales(start: Baseline, train: Windows, missing: Sequence[MissingTorque]) -> dict[str, float]:
    system, values = start.system, {}
    for placed in place(EFFECTS["learned"], system):
        j = placed.index
        weights = {p.name for p in placed.parameters(system.base) if p.name not in SCALES}
        # Weights that a model file brought along mean something in their own scales only.
        had = {name for name in weights if start.values[f"{placed.name}.{name}"] != 0.0}
        if not any(map(is_spring, had)):
            low, high = float(missing[j].theta.min()), float(missing[j].theta.max())
            values[f"{placed.name}.angle_middle"] = 0.5 * (low + high)
            values[f"{placed.name}.angle_scale"] = max(0.5 * (high - low), 1e-9)
        if not all(map(is_spring, had)):
            continue
        speed = float(np.abs(missing[j].omega).max())
        values[f"{placed.name}.speed_scale"] = max(speed, 1e-6)
        if j in system.command_joints:
            k = system.command_joints.index(j)
            largest = max(float(np.abs(c.column(k)).max()) for c in train.commands)
            values[f"{placed.name}.effort_scale"] = max(largest, 1e-9)
    return values


def _resting(train: Windows, missing: Sequence[MissingTorque]) -> tuple[int, ...]:
    """Joints that rest: a spring somewhere in their way would be a wall."""
    found = []
    for j, own in enumerate(missing):
        noise = [n.sd for n, state in zip(train.noise, train.shows, strict=True) if state == j]
        if np.ptp(own.theta) < STANDSTILL * min(noise, default=0.0):
            found.append(j)
    return tuple(found)


def _candidates(start: Baseline) -> list[Cause]:
    """Every term at every joint that the baseline does not free already, in the shape that the score test takes."""
    found, system = [], start.system.base
    for placed in place(EFFECTS["learned"], system):
        for p in placed.parameters(system):
            name = f"{placed.name}.{p.name}"
            if p.name not in SCALES and name not in start.prior.names:
                found.append(
                    Cause(
                        name,
                        "learned",
                        (name,),
                        "",
                        "",
                        "theta",
                        lambda motion: np.zeros_like(motion.time),
                        effect=placed.name,
                        joint=placed.index,
                    )
                )
    return found


def _choose(
    start: Baseline,
    train: Windows,
    choose: np.ndarray,
    reference: Fit,
    scaled: Mapping[str, float],
    offered: Sequence[Cause],
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Names of the weights that pay on the windows that choose, and the error there after each term."""
    system = start.system
    inner, others = FitProblem(system, train.take(~choose)), replace(train.take(choose), varies={})
    state = reference.state[torch.from_numpy(~choose)]
    fit = inner.fit_one(Trial("refit", reference.free, start.prior, scaled, state, reference.nuisance))
    errors = [_error(inner, fit, others)]
    chosen: list[str] = []
    kept, failed = 0, 0
    while len(chosen) < MOST_TERMS and failed < PATIENCE:
        left = [c for c in offered if c.name not in chosen]
        prior = _prior(inner, start, scaled, chosen)
        best = max(screen(inner, fit, prior, [(c, {}) for c in left]), key=lambda p: p.promise)
        if best.promise < WORTH:
            break
        chosen.append(best.cause.name)
        fit = _fit(inner, start, fit.values, chosen, fit, fit.state)
        errors.append(_error(inner, fit, others))
        better = errors[-1] < BETTER * errors[kept]
        kept, failed = (len(chosen), 0) if better else (kept, failed + 1)
    return tuple(chosen[:kept]), tuple(errors)


def _prior(problem: FitProblem, start: Baseline, values: Mapping[str, float], names: Sequence[str]):
    found = [c for c in _candidates(start) if c.name in names]
    return prior_with(problem, start, found, values)


def _fit(
    problem: FitProblem,
    start: Baseline,
    values: Mapping[str, float],
    names: Sequence[str],
    before: Fit,
    state: torch.Tensor,
) -> Fit:
    prior = _prior(problem, start, values, names)
    trial = Trial("learned", prior.names, prior, values, state, before.nuisance)
    return problem.fit_one(trial, ITERATIONS)


def _error(problem: FitProblem, fit: Fit, others: Windows) -> float:
    """chi2 per sample with the parameters of a fit on windows of the same logs that it has not seen."""
    unseen = FitProblem(problem.system, problem.elsewhere(others, fit))
    return unseen.evaluate(fit.values).chi2 / others.samples


def _without_idle_terms(
    problem: FitProblem, start: Baseline, scaled: Mapping[str, float], names: Sequence[str], reference: Fit
) -> tuple[Fit, tuple[Term, ...]]:
    """Fit all terms, and again without the weakest as long as its weight may be none (backward elimination)."""
    while True:
        fit = _fit(problem, start, scaled, names, reference, reference.state)
        terms = _terms(problem, fit, names, dispersion(fit, problem.windows).deflation)
        weakest = min(terms, key=lambda t: abs(t.weight) / max(t.sd, 1e-12))
        if len(terms) == 1 or abs(weakest.weight) >= LEAST_WEIGHT * weakest.sd:
            return fit, terms
        names = tuple(n for n in names if n != weakest.name)


def _terms(problem: FitProblem, fit: Fit, names: Sequence[str], deflation: float) -> tuple[Term, ...]:
    result = []
    for name in names:
        i = fit.free.index(name)
        sd = float(np.sqrt(max(fit.covariance[i, i], 0.0) * deflation))
        result.append(Term(name, fit.values[name], sd, problem.system.parameter(name).unit))
    return tuple(result)

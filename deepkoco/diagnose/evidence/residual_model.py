"""Learned load for residuals that no cause of the catalogue explains: sparse regression on simulation errors.

Terms in angle, speed and effort are added one by one (:mod:`deepkoco.diagnose.evidence.term_choice`). Validation
windows, which are part of the training data but not of the fits of this choice, decide how many terms are kept. Terms
that later ones make superfluous are dropped. The held-out windows decide whether the learned load is kept.

Source: forward selection, Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 3.3.2; the score test
    as in :mod:`deepkoco.diagnose.evidence.screening`. The library of terms is in the spirit of Brunton, Proctor, Kutz,
    PNAS 113(15), 2016 (SINDy), but the regression is on simulated trajectories, not on derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.event_windows import as_in
from deepkoco.diagnose.evidence.learned_promise import may_win
from deepkoco.diagnose.evidence.term_choice import MOST_TERMS, choose_terms, fit_terms, terms_of
from deepkoco.diagnose.gain import Gain, held_out_gain
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.fit.data.windows import STANDSTILL, Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.systems.effects import EFFECTS, place
from deepkoco.systems.effects.learned import SCALES, is_spring

VALIDATED = 4  # one training window in four validates the number of terms
MIN_MODEL_WINDOWS = 6
LEAST_WEIGHT = 2.0  # standard deviations of a weight below which its term is dropped


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
    """A learned load and its held-out error.

    Attributes:
        accepted: Whether it lowers the held-out error; only then it becomes part of the simulation.
        reason: Why it is accepted or rejected.
        terms: Its terms in the order in which they were chosen.
        fit: Fit on all training windows.
        gain: Held-out errors with the learned load as "extended"; None without held-out windows or terms.
        validation: chi2 per sample on the validation windows after 0, 1, 2, ... terms.
        before: chi2 per sample of the refit on the training windows.
        after: chi2 per sample with the terms on the training windows.
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
        held: Held-out windows, which decide whether the load is accepted.
        reference: The refitted baseline on the training windows.
        missing: Missing load at each joint, which gives the ranges of angles and speeds.
        seed: Seed of the bootstrap.

    Returns:
        The learned load; None where there are too few windows to choose terms.
    """
    if len(train) < MIN_MODEL_WINDOWS:
        return None
    system = start.system
    scaled = {**reference.values, **_scales(start, train, missing)}
    choose = np.arange(len(train)) % VALIDATED == VALIDATED - 2
    offered = [c for c in terms_of(start) if not (is_spring(c.name) and c.joint in _resting(train, missing))]
    names, validation = choose_terms(start, train, choose, reference, scaled, offered)
    problem = FitProblem(system, train)
    before = reference.chi2 / train.samples
    if not names:
        text = "no term in angle, speed and effort lowers the error on the validation windows"
        return ResidualModel(False, text, (), reference, None, validation, before, before)
    fit, terms = _without_idle_terms(problem, start, scaled, names, reference)
    after = fit.chi2 / train.samples
    if held is None or len(held) == 0:
        text = "there are no held-out windows to test it"
        return ResidualModel(False, text, terms, fit, None, validation, before, after)
    models = {
        "baseline": start.values,
        "refit": as_in(held, reference.values, train),
        "extended": as_in(held, fit.values, train),
    }
    windows = {
        "baseline": replace(held, varies={}),
        "refit": problem.elsewhere(held, reference),
        "extended": problem.elsewhere(held, fit),
    }
    gain = held_out_gain(system, windows, models, seed)
    if gain is None:
        text = "the simulation diverges on the held-out windows, so these cannot test it"
        return ResidualModel(False, text, terms, fit, None, validation, before, after)
    accepted = gain.low > 0.0
    span = f"{100 * gain.reduction:.0f} % ({100 * gain.low:.0f} to {100 * gain.high:.0f} %)"
    text = (
        f"it lowers the held-out error by {span}"
        if accepted
        else f"its held-out gain is {span}, which is not clearly above 0"
    )
    return ResidualModel(accepted, text, terms, fit, gain, validation, before, after)


def load_may_win(
    start: Baseline,
    problem: FitProblem,
    final: Fit,
    accepted: Sequence[Cause],
    missing: Sequence[MissingTorque],
    least: float,
) -> bool:
    """Return whether a learned load could be ahead of the selected causes by a fall of the BIC (:func:`.may_win`).

    Args:
        start: The baseline.
        problem: The training windows.
        final: Fit with the selected causes.
        accepted: These causes.
        missing: Missing load at each joint, which gives the ranges of angles and speeds.
        least: The fall of the BIC.
    """
    train = problem.windows
    offered = [c for c in terms_of(start) if not (is_spring(c.name) and c.joint in _resting(train, missing))]
    return may_win(
        start, problem, final, accepted, _scales(start, train, missing), offered, MOST_TERMS, least
    )


def _scales(start: Baseline, train: Windows, missing: Sequence[MissingTorque]) -> dict[str, float]:
    system, values = start.system, {}
    for placed in place(EFFECTS["learned"], system):
        j = placed.index
        weights = {p.name for p in placed.parameters(system.base) if p.name not in SCALES}
        # Weights from a model file are valid only with the scales of that file.
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
    """Joints that rest; a spring term there would act like a wall, so it is not offered."""
    found = []
    for j, own in enumerate(missing):
        noise = [n.sd for n, state in zip(train.noise, train.shows, strict=True) if state == j]
        if np.ptp(own.theta) < STANDSTILL * min(noise, default=0.0):
            found.append(j)
    return tuple(found)


def _without_idle_terms(
    problem: FitProblem, start: Baseline, scaled: Mapping[str, float], names: Sequence[str], reference: Fit
) -> tuple[Fit, tuple[Term, ...]]:
    """Fit all terms, and drop the weakest term while its weight may be zero (backward elimination)."""
    while True:
        fit = fit_terms(problem, start, scaled, names, reference, reference.state)
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

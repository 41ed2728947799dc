"""Choice of the terms of a learned load: chains of terms, each the most promising beside those before it.

The score test chooses the next term of a chain; multiple shooting refits it with all others and with the baseline's
parameters. Windows that are not part of this fit decide how many terms are kept, and which chain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.promising import WORTH
from deepkoco.diagnose.evidence.screening import screen
from deepkoco.diagnose.residuals.residuals import white_limit
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems.effects import EFFECTS, place
from deepkoco.systems.effects.learned import SCALES

MOST_TERMS = 6
BETTER = 0.99  # validation error over the best one before, below which a term is kept
# First terms that are tried, each with terms after it. The term that explains most alone need not be one of those that
# explain most together: of a dry friction and an offset, it is a friction that grows with the effort.
FIRST = 3
PATIENCE = 2  # terms in a row that may fail to lower the validation error
ITERATIONS = 12


def terms_of(start: Baseline) -> list[Cause]:
    """Return every term at every joint that the baseline does not free already, as causes for the score test."""
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


def choose_terms(
    start: Baseline,
    train: Windows,
    choose: np.ndarray,
    reference: Fit,
    scaled: Mapping[str, float],
    offered: Sequence[Cause],
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Return the weights that lower the validation error, and the validation error after each term."""
    system = start.system
    inner, others = FitProblem(system, train.take(~choose)), replace(train.take(choose), varies={})
    state = reference.state[torch.from_numpy(~choose)]
    fit = inner.fit_one(Trial("refit", reference.free, start.prior, scaled, state, reference.nuisance))
    errors = [_error(inner, fit, others)]
    nothing = _Chain((), errors[0], tuple(errors))
    promises = _promises(inner, start, scaled, fit, (), offered)
    chains = [nothing]
    for first in promises[:FIRST]:
        chains.append(_chain(inner, start, scaled, fit, others, offered, first, errors[0]))
        if chains[-1].error <= start.floor * white_limit(others):
            break  # only noise is left
    # A chain that keeps no term still tells what its terms did.
    best = min(chains[1:], key=lambda c: c.error, default=nothing)
    return best.names, best.validation


class _Chain(NamedTuple):
    """Terms that were added one by one.

    Attributes:
        names: Those that lowered the validation error.
        error: Validation error with them.
        validation: Validation error after 0, 1, 2, ... terms.
    """

    names: tuple[str, ...]
    error: float
    validation: tuple[float, ...]


def _chain(
    inner: FitProblem,
    start: Baseline,
    scaled: Mapping[str, float],
    fit: Fit,
    others: Windows,
    offered: Sequence[Cause],
    first: str,
    before: float,
) -> _Chain:
    """Return the terms that lower the validation error, the first one given and each next one the most promising."""
    errors, chosen = [before], [first]
    kept, failed = 0, 0
    while True:
        fit = fit_terms(inner, start, fit.values, chosen, fit, fit.state)
        errors.append(_error(inner, fit, others))
        better = errors[-1] < BETTER * errors[kept]
        kept, failed = (len(chosen), 0) if better else (kept, failed + 1)
        if len(chosen) == MOST_TERMS or failed == PATIENCE:
            break
        following = _promises(inner, start, scaled, fit, chosen, offered)
        if not following:
            break
        chosen.append(following[0])
    return _Chain(tuple(chosen[:kept]), errors[kept], tuple(errors))


def _promises(
    inner: FitProblem,
    start: Baseline,
    scaled: Mapping[str, float],
    fit: Fit,
    chosen: Sequence[str],
    offered: Sequence[Cause],
) -> list[str]:
    """Return the terms that are worth a fit by the score test, the most promising first."""
    left = [(c, {}) for c in offered if c.name not in chosen]
    found = screen(inner, fit, prior_of(inner, start, scaled, chosen), left)
    return [p.cause.name for p in sorted(found, key=lambda p: -p.promise) if p.promise >= WORTH]


def prior_of(
    problem: FitProblem, start: Baseline, values: Mapping[str, float], names: Sequence[str]
) -> Prior:
    found = [c for c in terms_of(start) if c.name in names]
    return prior_with(problem, start, found, values)


def fit_terms(
    problem: FitProblem,
    start: Baseline,
    values: Mapping[str, float],
    names: Sequence[str],
    before: Fit,
    state: torch.Tensor,
) -> Fit:
    prior = prior_of(problem, start, values, names)
    trial = Trial("learned", prior.names, prior, values, state, before.nuisance)
    return problem.fit_one(trial, ITERATIONS)


def _error(problem: FitProblem, fit: Fit, others: Windows) -> float:
    """Return chi2 per sample of a fit on other windows of the same logs."""
    unseen = FitProblem(problem.system, problem.elsewhere(others, fit))
    return unseen.evaluate(fit.values).chi2 / others.samples

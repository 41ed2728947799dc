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
LOOK = 2  # terms of each chain, after which the best chain alone goes on
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
    """Return the weights that lower the validation error, and the validation error after each term.

    Args:
        start: The baseline.
        train: W windows of the training data.
        choose: (W,) true for the windows that choose terms and are not fitted.
        reference: Fit of the baseline to ``train``.
        scaled: Values of all parameters, with the ranges that the terms are scaled by.
        offered: Terms, as :func:`terms_of` returns them.

    Returns:
        Names of the weights that are kept, and chi2 per sample of the windows that choose after 0, 1, 2, ... terms.
    """
    system = start.system
    inner, others = FitProblem(system, train.take(~choose)), replace(train.take(choose), varies={})
    state = reference.state[torch.from_numpy(~choose)]
    fit = inner.fit_one(Trial("refit", reference.free, start.prior, scaled, state, reference.nuisance))
    task = _Task(inner, start, scaled, others, offered)
    before = _error(inner, fit, others)
    chains = []
    for first in _promises(task, fit, ())[:FIRST]:
        chains.append(_Chain((first,), fit, (before,)))
        for _ in range(LOOK):
            chains[-1] = _grown(task, chains[-1])
        if chains[-1].error <= start.most_noise(others):
            break  # only noise is left
    if not chains:
        return (), (before,)
    # A chain that keeps no term still tells what its terms did.
    best = min(chains, key=lambda c: (c.error, min(c.validation[1:])))
    while not best.ended:
        best = _grown(task, best)
    return best.names[: best.kept], best.validation


class _Task(NamedTuple):
    """What the terms of every chain are fitted to (``inner``) and judged by (``others``)."""

    inner: FitProblem
    start: Baseline
    scaled: Mapping[str, float]
    others: Windows
    offered: Sequence[Cause]


class _Chain(NamedTuple):
    """Terms that are added one by one.

    Attributes:
        names: Terms so far, the last one not yet fitted unless the chain has ended.
        fit: Fit with all terms but that one.
        validation: Validation error after 0, 1, 2, ... terms.
        kept: Number of terms up to the last one that lowered the validation error.
        failed: Number of terms after it.
        ended: Whether no more term is worth a fit.
    """

    names: tuple[str, ...]
    fit: Fit
    validation: tuple[float, ...]
    kept: int = 0
    failed: int = 0
    ended: bool = False

    @property
    def error(self) -> float:
        """Validation error with the terms that are kept."""
        return self.validation[self.kept]


def _grown(task: _Task, chain: _Chain) -> _Chain:
    """Return a chain with its next term fitted, and the most promising one after it named."""
    if chain.ended:
        return chain
    names = chain.names
    fit = fit_terms(task.inner, task.start, chain.fit.values, names, chain.fit, chain.fit.state)
    errors = (*chain.validation, _error(task.inner, fit, task.others))
    better = errors[-1] < BETTER * chain.error
    kept, failed = (len(names), 0) if better else (chain.kept, chain.failed + 1)
    following: list[str] = []
    if len(names) < MOST_TERMS and failed < PATIENCE:
        following = _promises(task, fit, names)
    return _Chain((*names, *following[:1]), fit, errors, kept, failed, not following)


def _promises(task: _Task, fit: Fit, chosen: Sequence[str]) -> list[str]:
    """Return the terms that are worth a fit by the score test, the most promising first."""
    left = [(c, {}) for c in task.offered if c.name not in chosen]
    found = screen(task.inner, fit, prior_of(task.inner, task.start, task.scaled, chosen), left)
    return [p.cause.name for p in sorted(found, key=lambda p: -p.promise) if p.promise >= WORTH]


def prior_of(
    problem: FitProblem, start: Baseline, values: Mapping[str, float], names: Sequence[str]
) -> Prior:
    """Return the prior of the baseline's parameters and of the weights of these terms."""
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
    """Fit the weights of these terms with the baseline's parameters, from ``values`` and (W, S) initial states."""
    prior = prior_of(problem, start, values, names)
    trial = Trial("learned", prior.names, prior, values, state, before.nuisance)
    return problem.fit_one(trial, ITERATIONS)


def _error(problem: FitProblem, fit: Fit, others: Windows) -> float:
    """Return chi2 per sample of a fit on other windows of the same logs."""
    unseen = FitProblem(problem.system, problem.elsewhere(others, fit))
    return unseen.evaluate(fit.values).chi2 / others.samples

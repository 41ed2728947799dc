"""Expected likelihood ratios by real refits: each cause fitted to what the others would make of a sequence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.evidence.selection import prior_with
from deepkoco.diagnose.experiment_design.doses import Dose
from deepkoco.diagnose.experiment_design.experiment_setup import Stage
from deepkoco.diagnose.experiment_design.rehearsal import Rehearsal, measured, rehearse
from deepkoco.fit.fit import FitProblem, Trial

ITERATIONS = 25
STARTS = (
    1.0,
    0.3,
    -0.5,
)  # doses from which a rival is fitted; one that is not admissible is cut to its bound


def confirm(
    stage: Stage, feedforward: np.ndarray, doses: Sequence[Dose]
) -> tuple[np.ndarray, list[Rehearsal]]:
    """Refit every rival to noise-free data of every cause.

    Args:
        stage: The experiment.
        feedforward: (n, M) commands.
        doses: C causes.

    Returns:
        (C, C) chi2 that a log made by the first cause leaves when the second is fitted to it, above what the first
        itself leaves; and what each cause makes of the sequence.
    """
    count = len(doses)
    ratio, played = np.zeros((count, count)), []
    for a, truth in enumerate(doses):
        made = rehearse(stage, feedforward[None], [truth.on(stage.start.values)])
        played.append(made)
        if len(made.windows) == 0:
            continue
        problem = FitProblem(stage.system, measured(stage, made, truth.on(stage.start.values)))
        trials = [trial for b, dose in enumerate(doses) for trial in _trials(problem, stage, dose, a == b)]
        best: dict[str, float] = {}
        for fit in problem.fit(trials, ITERATIONS):
            best[fit.name] = min(best.get(fit.name, np.inf), fit.cost)
        own = best[truth.cause.name]
        if not np.isfinite(own):
            continue
        ratio[a] = [max(best[dose.cause.name] - own, 0.0) for dose in doses]
    return ratio, played


def _trials(problem: FitProblem, stage: Stage, dose: Dose, truth: bool) -> list[Trial]:
    result = []
    for factor in (1.0,) if truth else STARTS:
        values = {**stage.start.values, **dose.scaled(factor, stage.system).values}
        prior = prior_with(problem, stage.start, [dose.cause], values)
        result.append(Trial(dose.cause.name, prior.names, prior, values))
    return result

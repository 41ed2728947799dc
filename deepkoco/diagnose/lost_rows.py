"""Commands in the rows that a log lost, fitted beside the causes that explain it.

What acted in a lost row is fitted with the parameters where the simulation leaves no more than noise then
(:mod:`..fit.solve.guessed_commands`). A fault hides that, so the commands are fitted again beside the causes that were
found, and the causes are asked for once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.data import Data
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.refitted import Refitted, data_with_lost_rows_fitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.weighed import explained
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.guessed_commands import guesses_in
from deepkoco.fit.solve.scaled_inverse import DivergedError


def with_lost_rows_beside(
    request: DiagnosisRequest, explanation: Explanation, unfitted: Sequence[str] = ()
) -> tuple[DiagnosisRequest, Explanation]:
    """Explain the logs again, with commands in their lost rows that were fitted beside the causes that were found.

    Args:
        request: The logs, and the causes to try.
        explanation: What explains them.
        unfitted: What could not be fitted so far, in words.

    Returns:
        Both as they are where these commands are known, or where more than noise is left with them.
    """
    base, found = explanation.base, explanation.found
    if not (guesses_in(request.data.train) and guesses_in(base.train)):
        return request, explanation
    if not request.limit.allows("commands of lost rows beside the causes"):
        return request, explanation
    beside = [(found.final, found.accepted)]
    if not found.accepted and explanation.first.candidates:
        beside.append((explanation.first.best.fit, (explanation.first.best.cause,)))
    for fit, causes in beside:
        data = _data_beside(request.data, base, fit, causes)
        if data is not None:
            request.progress("again, with the commands of lost rows")
            other = replace(request, data=data)
            try:
                return other, explained(other, base.learned, unfitted)
            except DivergedError:
                return request, explanation
    return request, explanation


def _data_beside(data: Data, base: Refitted, fit: Fit, causes: Sequence[Cause]) -> Data | None:
    """The windows with the commands of lost rows that leave only noise beside some causes; None where none do."""
    problem_of = partial(FitProblem, base.start.system)
    prior = prior_with(base.problem, base.start, causes, fit.values)
    state = problem_of(data.train).evaluate(fit.values).state
    again = problem_of(data.train).fit([Trial("lost rows", prior.names, prior, fit.values, state)])[0]
    if again.diverged:
        return None
    data, _ = data_with_lost_rows_fitted(problem_of, data, again, prior)
    return None if guesses_in(data.train) else data

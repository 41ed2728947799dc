"""Parameters that a log shows far from what is stated of them, where nothing else is needed to explain it.

A cause is chosen among the whole catalogue, and the fall of the BIC that a name needs pays for this choice. Whether the
stated value of a parameter is right is another question. Whoever stated a standard deviation asked it beforehand, once
for each parameter. A refit under the stated priors explains such a log at a price of a few standard deviations, and
"nothing" would be the answer to a pressure that is a quarter lower than stated.

The fall of the cost without the prior of one parameter is, in that prior's units, its squared distance: chi2 with one
degree of freedom where the stated values are right. The chance that one of all parameters is that far is below CHANCE.

Source: likelihood-ratio test with Bonferroni's bound; Pawitan, In All Likelihood, ch. 9.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from deepkoco.diagnose.causes import is_changed
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.ranking import Candidate
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.explanation import Explanation, of_mean
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.verdict.findings import estimates
from deepkoco.diagnose.verdict.judgement import Judgement, judge
from deepkoco.fit.solve.scaled_inverse import DivergedError

CHANCE = 0.01  # that any parameter of a unit that is as stated would be called off
FAR = 3.0  # stated standard deviations from which a value is off
CERTAIN = 2.0  # of them, beyond which its whole interval lies


def with_values_off_the_sheet(
    request: DiagnosisRequest, explanation: Explanation, judgement: Judgement
) -> tuple[Explanation, Judgement]:
    """Name a parameter that is far from its stated value where the verdict would be "nothing".

    The cause that leads the class is named as always: a mechanism may explain the log as well as the parameter. Healthy
    logs state a value in another way, and what differs from them is decided by the selection alone.

    Args:
        request: The logs.
        explanation: The refit and the causes that were tried.
        judgement: The verdict on them.

    Returns:
        Both as they are, or with the cause where it is confirmed.
    """
    base, first = explanation.base, explanation.first
    if (
        judgement.verdict != "nothing"
        or base.learned.healthy is not None
        or base.start.tempering > 1.0
        or explanation.found.lost is not None
    ):
        return explanation, judgement
    best = off_the_sheet(explanation, fall_for_parameter(explanation) + request.detection - DETECTION)
    # What explains the log clearly better is no more than the selection has found it to be.
    if best is None or first.best.delta_bic - best.delta_bic > APART:
        return explanation, judgement
    if not request.limit.allows("values far from what is stated"):
        return explanation, judgement
    # The BIC also charges the length of the log.
    charge = best.likelihood_ratio / first.deflation - best.delta_bic
    wanted = max(fall_for_parameter(explanation) + request.detection - DETECTION - charge, 0.0)
    request.progress(f"{best.cause.name}, which is far from what is stated")
    selection = Selection(
        base.start, base.train, base.data.held, request.causes, wanted, request.progress, request.limit
    )
    try:
        found = selection.from_ranking(first)
        again = of_mean(replace(explanation, found=found, wanted=wanted))
        confirmed = judge(request, again)
    except DivergedError:
        return explanation, judgement
    if confirmed.verdict not in ("cause", "ambiguous") or not found.accepted:
        return explanation, judgement
    return again, confirmed


def off_the_sheet(explanation: Explanation, least: float) -> Candidate | None:
    """Return the parameter that is off with most evidence; None where none is.

    Args:
        explanation: The refit, and the causes that were tried.
        least: Fall of the cost without its prior from which a parameter is off [noise variances, deflated].
    """
    first = explanation.first
    found = []
    for c in first.candidates:
        if (
            not is_changed(c.cause)
            or c.fit is first.reference
            or c.likelihood_ratio < least * first.deflation
        ):
            continue
        away, near = stated_sds(explanation, c)
        if away >= FAR and near >= CERTAIN:
            found.append(c)
    return max(found, key=lambda c: c.delta_bic, default=None)


def fall_for_parameter(explanation: Explanation) -> float:
    """Return the fall of the cost that chance gives to one of the parameters of which the log tells what is stated."""
    fit, prior = explanation.base.reference, explanation.base.start.prior
    stated = dict(zip(prior.names, prior.covariance.diagonal(), strict=True))
    known = fit.covariance.diagonal() * explanation.first.deflation
    told = sum(n in stated and var <= 0.5 * stated[n] for n, var in zip(fit.free, known, strict=True))
    return float(chi2.isf(CHANCE / max(told, 1), 1))


def stated_sds(explanation: Explanation, candidate: Candidate) -> tuple[float, float]:
    """Return how far a changed parameter, and the near end of its interval, is from its value [stated sds].

    Args:
        explanation: The refit, with the priors.
        candidate: Fit of the changed parameter.
    """
    base, (name,) = explanation.base, candidate.cause.free
    prior, value = base.start.prior, base.start.values[name]
    sd = base.start.system.parameter(name).prior_sd
    if name in prior.names:
        i = prior.names.index(name)
        sd = float(np.sqrt(prior.covariance[i, i]))
    if not sd > 0.0:
        return 0.0, 0.0
    e = estimates(base.problem, candidate.fit, [name], explanation.first.deflation)[name]
    near = 0.0 if e.low <= value <= e.high else min(abs(e.low - value), abs(e.high - value))
    return abs(e.value - value) / sd, near / sd

"""Parameters that a log shows far from what is stated of them, where nothing else is needed to explain it.

A cause is chosen among the whole catalogue, and the fall of the BIC that a name needs pays for this choice. Whether the
stated value of a parameter is right is another question. Whoever stated a standard deviation asked it beforehand, once
for each parameter. A refit under the stated priors explains such a log at a price of a few standard deviations, and
"nothing" would be the answer to a pressure that is a quarter lower than stated.

The fall of the cost without the prior of one parameter is, in that prior's units, its squared distance: chi2 with one
degree of freedom where the stated values are right. The chance that one of all parameters is that far is below CHANCE.

Where residuals are correlated, falls of the cost are divided by the deflation. That is right for chi2 and wrong for the
prior's part: a stated value is one statement, however many samples count as one. An encoder that rests rounds with a
constant error; without more, a friction would have to be five times as many stated deviations off as with noise. The
causes are then asked once more under priors that count as the residuals do, and the whole cost is divided.

Source: likelihood-ratio test with Bonferroni's bound; Pawitan, In All Likelihood, ch. 9.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from deepkoco.diagnose.baseline import tempered
from deepkoco.diagnose.causes import is_changed
from deepkoco.diagnose.data_sheet import guessed
from deepkoco.diagnose.evidence.absorbed import alike
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.explanation import Explanation, of_mean
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.diagnose.verdict.judgement import Judgement, judge
from deepkoco.fit.fit import Trial
from deepkoco.fit.solve.deflated import deflated
from deepkoco.fit.solve.scaled_inverse import DivergedError

CHANCE = 0.01  # that any parameter of a unit that is as stated would be called off
FAR = 3.0  # stated standard deviations from which a value is off
CORRELATED = (
    1.5  # times the residuals may count as fewer than the priors do, from which these are in proportion
)
MOSTLY = (
    0.5  # of the penalty that the change of a parameter saves, from which another cause stands in its place
)
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
    base = explanation.base
    if judgement.verdict != "nothing" or base.learned.healthy is not None or base.start.tempering > 1.0:
        return explanation, judgement
    # What any unit has was not named before, and it is no rival now.
    usual = {m.cause.name for m in explanation.found.minor if m.share is None}
    causes = [c for c in request.causes if c.name not in usual]
    asked = _without(explanation, usual)
    best = off_the_sheet(asked, _least(request, asked))
    if best is None and farthest(asked) > max(_least(request, asked), 0.0):
        try:
            asked = _without(asked_in_proportion(request, asked), usual)
        except DivergedError:
            return explanation, judgement
        best = off_the_sheet(asked, _least(request, asked))
    base, first = asked.base, asked.first
    if best is None:
        return explanation, judgement
    # What explains the log clearly better is no more than the selection has found it to be.
    if first.best.delta_bic - best.delta_bic > APART:
        return explanation, judgement
    first = replace(first, candidates=_instead_of(first, best))
    if not request.limit.allows("values far from what is stated"):
        return explanation, judgement
    # The BIC also charges the length of the log.
    charge = best.likelihood_ratio / first.deflation - best.delta_bic
    wanted = max(_least(request, asked) - charge, 0.0)
    request.progress(f"{best.cause.name}, which is far from what is stated")
    selection = Selection(
        base.start, base.train, base.data.held, causes, wanted, request.progress, request.limit
    )
    try:
        found = selection.from_ranking(first)
        again = of_mean(replace(asked, found=found, wanted=wanted))
        confirmed = judge(request, again)
    except DivergedError:
        return explanation, judgement
    if confirmed.verdict not in ("cause", "ambiguous") or not found.accepted:
        return explanation, judgement
    return again, confirmed


def asked_in_proportion(request: DiagnosisRequest, explanation: Explanation) -> Explanation:
    """Return an explanation whose causes are ranked under priors that count as much as the residuals do.

    With the priors times the deflation D, a fit minimises chi2 / D plus the penalty as it is stated.

    Args:
        request: The logs, and the causes to try.
        explanation: The refit under the priors as stated.

    Raises:
        DivergedError: The refit under these priors diverges.
    """
    base, had = explanation.base, explanation.base.reference
    factor = explanation.first.deflation / base.start.narrowed
    if not request.limit.allows("stated values in proportion to the residuals"):
        return explanation
    request.progress("stated values in proportion to the residuals")
    prior, narrowing = tempered(base.start.prior, factor), base.start.narrowing * factor
    start = replace(base.start, prior=prior, narrowing=narrowing)
    refit = base.problem.fit_one(Trial(had.name, had.free, prior, had.values, had.state, had.nuisance))
    held, causes, limit = base.data.held, request.causes, request.limit
    selection = Selection(start, base.train, held, causes, request.detection, request.progress, limit)
    first = selection.first_ranking(refit, missing_torque(base.problem, refit)).ranking
    return replace(explanation, base=replace(base, start=start, reference=first.reference), first=first)


def farthest(explanation: Explanation) -> float:
    """Return by how much the cost would fall without the prior of one parameter, the largest; 0 where it is known.

    With the slopes at the refit, everything is in closed form. With the information I of chi2, the precision P of the
    priors without that of the parameter, the deflation D, and the slope of chi2, which the priors balance at the refit,
    chi2 / D plus the other penalties has its minimum at x with the covariance C = (I / D + P)^-1. A stated value c with
    the standard deviation s is then off by (x - c)^2 / (s^2 + C) [chi2 with one degree of freedom].

    It is 0 where the first ranking has told already: for nearly independent residuals, for priors that nobody stated,
    and for those that count as much as the residuals do.

    Args:
        explanation: The refit.
    """
    base, fit, deflation = explanation.base, explanation.base.reference, explanation.first.deflation
    start, prior = base.start, base.start.prior
    if deflation < CORRELATED * start.narrowed or guessed(start) or not set(fit.free) <= set(prior.names):
        return 0.0
    precision, away = prior.penalty(fit.free).at(np.array([fit.values[n] for n in fit.free]))
    pull = precision @ away
    most = 0.0
    for i, name in enumerate(fit.free):
        declared = start.system.parameter(name).prior_sd
        if "." in name or not precision[i, i] > 0.0 or precision[i, i] ** -0.5 < 0.5 * declared:
            continue  # small effects, and the parameter of each open scale that is kept as given
        others = precision.copy()
        others[i] = others[:, i] = 0.0
        size = np.sqrt(fit.covariance.diagonal())
        curved = (fit.information / deflation + others) * np.outer(size, size)
        inverse = np.linalg.pinv(curved, hermitian=True) * np.outer(size, size)
        step = inverse @ (pull / deflation - others @ away)
        spread = inverse[i, i] + 1.0 / precision[i, i]
        most = max(most, float((away[i] + step[i]) ** 2 / spread))
    return most


def _without(explanation: Explanation, names: Collection[str]) -> Explanation:
    """Return the explanation with a ranking of the other causes."""
    first = explanation.first
    kept = tuple(c for c in first.candidates if c.cause.name not in names)
    return replace(explanation, first=replace(first, candidates=kept))


def _instead_of(first: Ranking, best: Candidate) -> tuple[Candidate, ...]:
    """Return the candidates with which parameters are as much nearer to what is stated as with the change of one.

    Another cause explains other errors. It was asked for among the whole catalogue, and its fall was too small.
    """
    saved = first.reference.penalty - best.fit.penalty
    return tuple(
        c for c in first.candidates if c is best or first.reference.penalty - c.fit.penalty >= MOSTLY * saved
    )


def _least(request: DiagnosisRequest, explanation: Explanation) -> float:
    return fall_for_parameter(explanation) + request.detection - DETECTION


def off_the_sheet(explanation: Explanation, least: float) -> Candidate | None:
    """Return the parameter that is off with most evidence; None where none is.

    What adds to a parameter stands for its change: dry friction beside the friction that is stated.

    Args:
        explanation: The refit, and the causes that were tried.
        least: Fall of the cost without its prior from which a parameter is off [noise variances, deflated].
    """
    first = explanation.first
    found = []
    for c in first.candidates:
        if c.fit is first.reference or c.likelihood_ratio < least * first.deflation:
            continue
        away = [stated_sds(explanation, c, n, value) for n, value in _values_of(explanation, c).items()]
        if any(far >= FAR and near >= CERTAIN for far, near in away):
            found.append(c)
    return max(found, key=lambda c: c.delta_bic, default=None)


def fall_for_parameter(explanation: Explanation) -> float:
    """Return the fall of the cost that chance gives to one of the parameters of which the log tells what is stated."""
    fit, prior = explanation.base.reference, explanation.base.start.prior
    narrowing = explanation.base.start.narrowing
    stated = dict(zip(prior.names, prior.covariance.diagonal() * narrowing, strict=True))
    known = deflated(fit, explanation.first.deflation, explanation.base.start.narrowed).diagonal()
    told = sum(n in stated and var <= 0.5 * stated[n] for n, var in zip(fit.free, known, strict=True))
    return float(chi2.isf(CHANCE / max(told, 1), 1))


def _values_of(explanation: Explanation, candidate: Candidate) -> dict[str, float]:
    """Return the values of the parameters of which a candidate is a change; usually none."""
    cause, fit = candidate.cause, candidate.fit
    if is_changed(cause):
        return {n: fit.values[n] for n in cause.free}
    return alike(explanation.base.problem, fit, cause, explanation.base.start.values)


def stated_sds(
    explanation: Explanation, candidate: Candidate, name: str, value: float
) -> tuple[float, float]:
    """Return how far a changed parameter, and the near end of its interval, is from its value [stated sds].

    Args:
        explanation: The refit, with the priors.
        candidate: Fit of the change.
        name: The parameter.
        value: Its value, with what the candidate adds to it.
    """
    base, fit = explanation.base, candidate.fit
    prior, given = base.start.prior, base.start.values[name]
    sd = base.start.system.parameter(name).prior_sd
    if name in prior.names:
        i = prior.names.index(name)
        sd = float(np.sqrt(prior.covariance[i, i] * base.start.narrowing))
    if not sd > 0.0:
        return 0.0, 0.0
    known = deflated(fit, explanation.first.deflation, base.start.narrowed)
    sums = sorted({fit.free.index(n) for n in (name, *candidate.cause.free)})
    reach = 1.96 * float(np.sqrt(max(known[np.ix_(sums, sums)].sum(), 0.0)))
    away = abs(value - given)
    return away / sd, max(away - reach, 0.0) / sd

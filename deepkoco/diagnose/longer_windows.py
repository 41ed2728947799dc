"""Repeat the last fits on windows of the usual length, where the causes were selected on shorter ones.

Short windows find a cause where the simulation as given leaves the motion (:mod:`deepkoco.diagnose.window_choice`).
They tell less of everything that adds up: a force of 1 N moves a car of 95 kg by 3 mm in 0.75 s, and by 12 mm in 1.5 s.
With its causes, the simulation mostly follows its logs for longer. Then the causes compete with those of their classes
again, and the parameters are fitted, in windows of the usual length. A constant load that no unit is without adds up as
well: where causes were weighed and such windows show more than noise, the fit contains a little of every small effect.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from torch import Tensor

from deepkoco.diagnose.baseline_refit import LONG
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, Data, cut_data
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.selection import FURTHER
from deepkoco.diagnose.explanation import Explanation, of_mean
from deepkoco.diagnose.little_of_all import beside
from deepkoco.diagnose.refitted import Refitted, data_with_lost_rows_fitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.diagnose.weighed import detection_of
from deepkoco.diagnose.window_choice import FOLLOWS, MUCH, left_out
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.fine_steps import MOST, STEP_ROUNDS, fine_steps, with_steps_cut
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import DivergedError

BRIEF = 40  # iterations of the refit without causes, which mostly stays far from the logs


def on_longer_windows(
    request: DiagnosisRequest, explanation: Explanation
) -> tuple[DiagnosisRequest, Explanation]:
    """Return the request and its explanation on longer windows; as they are where the simulation follows none.

    Args:
        request: The logs, and the windows in which the causes were selected.
        explanation: The selected causes.
    """
    base, found = explanation.base, explanation.found
    followed = request.length >= request.usual or not found.accepted
    # A push or lost commands belong to their windows. Of a large model error, longer windows only show more.
    pushed = found.lost is not None or any(c.effect == "event" for c in found.accepted)
    # Causes within their tolerance would be part of the one fit and not of the other.
    small = any(set(m.cause.free) <= set(found.final.free) for m in found.minor)
    # Where noise of the commands moves a simulation, it is what keeps it from following, not a missing cause.
    wanders = base.train.wander is not None
    if followed or pushed or small or wanders or base.start.tempering > 1.0:
        return request, explanation
    length = request.usual
    while length > request.length:
        data = _cut_like(base, cut_data(request.recordings, request.holdout, request.system, length))
        if (
            len(data.train) >= MIN_TRAINING_WINDOWS
            # A gain that is measured on held-out windows is worth more than longer windows.
            and (data.held is not None or base.data.held is None)
            and left_out(data.train, base.start, found.final.values) <= FOLLOWS
        ):
            if not request.limit.allows(f"fits on windows of {length:g} s"):
                break
            request.progress(f"the causes again, on windows of {length:g} s")
            try:
                again = _fitted_again(replace(request, data=data, length=length), explanation)
            except DivergedError:
                again = None  # without the causes, the simulation may run away in such windows
            if again is not None:
                return replace(request, data=again.base.data, length=length), again
        length *= 0.5
    return request, explanation


def _cut_like(base: Refitted, data: Data) -> Data:
    """Return windows with the noise, the stamps and the fineness of the steps that were found on shorter ones."""
    train = base.train
    parts = max(round(data.train.step / train.step), 1) if len(data.train) else 1
    like = {"noise": train.noise, "stamp_sd": train.stamp_sd, "varies": train.varies}
    held = None
    if data.held is not None and base.data.held is not None:
        own = base.data.held
        held = with_steps_cut(
            replace(data.held, noise=own.noise, stamp_sd=own.stamp_sd, varies=own.varies), parts
        )
    return replace(data, train=with_steps_cut(replace(data.train, **like), parts), held=held)


def _fitted_again(request: DiagnosisRequest, explanation: Explanation) -> Explanation | None:
    """Refit the baseline and the selection on other windows; None where a simulation diverges or no cause stays."""
    base, found, data = explanation.base, explanation.found, request.data
    start = base.start
    prior = prior_with(base.problem, start, found.accepted, found.final.values)
    problem_of = partial(FitProblem, start.system)
    problem = problem_of(data.train)
    final = _refit(problem, found.final, prior.names, prior)
    if not final.diverged:
        data, final = data_with_lost_rows_fitted(problem_of, data, final, prior)
        problem = problem_of(data.train)
    most = MOST
    for _ in range(STEP_ROUNDS):
        # An error of a step adds up for longer, too.
        parts = 1 if final.diverged else fine_steps(problem_of, data.train, final, most)
        most //= parts
        if parts == 1:
            break
        held = None if data.held is None else with_steps_cut(data.held, parts)
        data = replace(data, train=with_steps_cut(data.train, parts), held=held)
        problem = problem_of(data.train)
        final = _refit(problem, final, prior.names, prior)
    # Of an unstable plant, a fit of windows in which the simulation runs away finds no minimum.
    if final.diverged or final.stuck:
        return None
    everything = request.causes
    limit = start.most_noise(data.train) * data.train.samples
    # A carriage that detents catch at another place is far from the log though nothing is missing.
    explained = found.final.chi2 <= start.most_noise(base.train) * base.train.samples
    if explained and final.chi2 > MUCH * limit:
        return None
    if explanation.weighed and final.chi2 > limit and request.limit.allows("small effects that any unit has"):
        grown, fit = beside(problem, start, final, found.accepted, everything)
        fallen = (final.cost - fit.cost) / dispersion(final, data.train).deflation
        if not fit.diverged and fallen > FURTHER:
            start, final = grown, fit
    known = base.reference
    values = {n: start.values[n] for n in start.prior.names} | {n: known.values[n] for n in known.free}
    known = replace(known, values={**known.values, **values})
    reference = _refit(problem, known, start.prior.names, start.prior, final.state, BRIEF)
    if reference.diverged:
        return None
    # A refit far outside its prior can imitate a cause, and leave no error in these windows that the cause explains.
    if _gain_of_prior(reference, final) and not _gain_of_prior(base.reference, found.final):
        return None
    longer = replace(base, start=start, data=data, problem=problem, reference=reference)
    # The causes of their classes compete once more; the rankings of shorter windows do not count.
    members = {name for _, names in found.steps for name in names} | {c.name for c in found.accepted}
    rivals = [c for c in everything if c.name in members]
    steps = tuple((replace(ranking, asked=()), names) for ranking, names in found.steps)
    wanted = detection_of(request, explanation)
    selection = Selection(start, longer.train, longer.held, rivals, wanted, request.progress, request.limit)
    again = selection.repeated(replace(found, final=final, steps=steps, acting=problem), reference)
    stale = any(len(ranking.reference.state) != len(longer.train) for ranking, _ in again.steps)
    if stale or not again.accepted:
        return None
    return of_mean(replace(explanation, base=longer, found=again, longer=True))


def _gain_of_prior(reference: Fit, final: Fit) -> bool:
    """Return whether causes gain more by the price of the prior than by the error of the simulation."""
    return reference.penalty - final.penalty > reference.chi2 - final.chi2


def _refit(
    problem: FitProblem,
    fit: Fit,
    free: tuple[str, ...],
    prior: Prior,
    state: Tensor | None = None,
    iterations: int = LONG,
) -> Fit:
    """Repeat a fit on other windows, from initial states that suit its values."""
    state, _ = problem.fit_states(fit.values, problem.windows.state if state is None else state)
    return problem.fit([Trial("refit", free, prior, fit.values, state, fit.nuisance)], iterations)[0]

"""Baseline from healthy logs of the unit: parameters, small effects, floor and run-to-run variance."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deepkoco.diagnose.baseline import (
    Baseline,
    BaselineError,
    Healthy,
    LosingCommands,
    Near,
    baseline_from,
    with_gauges_fixed,
)
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.between_rows import as_recorded
from deepkoco.diagnose.causes import Cause, catalogue, is_changed, kind_of, measured_channels, shown_causes
from deepkoco.diagnose.causes.timing import LOST_COMMANDS
from deepkoco.diagnose.evidence.classes import equivalent
from deepkoco.diagnose.evidence.elimination import BENDING, eliminated
from deepkoco.diagnose.evidence.minor import tolerated
from deepkoco.diagnose.evidence.priors import freed, prior_with
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.evidence.refine_ranking import front_settled
from deepkoco.diagnose.evidence.selection import DETECTION, PATIENCE, rank
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.healthy_spread import Spread, spread_of
from deepkoco.diagnose.late_speeds import delay_of_speeds
from deepkoco.diagnose.left_of_logs import DELAYS
from deepkoco.diagnose.lost_commands.report import best_losses
from deepkoco.diagnose.progress import Progress, in_company_of, silent
from deepkoco.diagnose.residuals.residuals import missing_torque, white_limit
from deepkoco.diagnose.run_to_run import RunToRun, posterior, unshown, with_ratios, within_bounds
from deepkoco.diagnose.time_limit import TimeLimit
from deepkoco.fit.data.windows import Windows, cut_windows, moving
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.fit.threads import one_thread
from deepkoco.logs.held_values import with_held_values
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

# Largest number of small effects that are added to the baseline of a healthy unit, beside delays of its recorder.
LARGEST_EXTENSION = 6
SHARE_OF_BEST = (
    0.5  # of what the best cause explains, from which another one is asked whether any machine has it
)


@one_thread()
def learn_baseline(
    recordings: Sequence[Recording],
    system: System,
    length: float,
    progress: Progress = silent,
    extension: int = LARGEST_EXTENSION,
    limit: TimeLimit | None = None,
) -> Baseline:
    """Refit, and where needed extend, the baseline on logs in which nothing is wrong.

    Small effects that every log of the unit shows (a lag of 2 ms, some load friction) would otherwise be named as
    causes later. Forward selection on the healthy logs adds them to the baseline. The uncertainty of that fit
    becomes the prior of the diagnosis, and its chi2 per sample becomes the floor. With two or more logs, the
    run-to-run variance of their separate refits widens the prior. Each log then has its own parameters in every fit,
    and this variance is estimated again after each added effect. Causes that the logs cannot distinguish from an
    added effect are added too.

    Args:
        recordings: Healthy logs.
        system: The system.
        length: Length of the windows [s].
        progress: Called with the name of each step.
        extension: Largest number of small effects that are added, beside delays of the recorder.
        limit: Asked before each of them; it remembers what it refused. None allows all.
    """
    recordings = [with_held_values(log) for log in recordings]
    read = as_recorded(recordings, system, length)
    logs = read.logs(recordings)
    learned = learn_as_simulated(logs, read.system, length, progress, extension, limit, read.near)
    return replace(learned, early=read.early)


@one_thread()
def learn_as_simulated(
    recordings: Sequence[Recording],
    system: System,
    length: float,
    progress: Progress = silent,
    extension: int = LARGEST_EXTENSION,
    limit: TimeLimit | None = None,
    near: Near | None = None,
    enough: Callable[[Baseline], bool] | None = None,
) -> Baseline:
    """As :func:`learn_baseline`, where it is known whether the logs are of a machine or of an engine.

    Args:
        recordings, system, length, progress, extension, limit: As there.
        near: What earlier fits of the logs have told; None for none.
        enough: Asked, with what is learned so far, whether no further small effect is wanted; None wants all.
    """
    limit = TimeLimit() if limit is None else limit
    try:
        # Every effect changes the floor, and only the last one counts.
        return _learn(recordings, system, length, progress, extension, limit, near, enough, False)
    except FloorError:
        return _learn(recordings, system, length, progress, extension, limit, near, enough, True)


class FloorError(DivergedError):
    """A single healthy log has no simulation that stays finite under what all of them tell."""


def _learn(
    recordings: Sequence[Recording],
    system: System,
    length: float,
    progress: Progress,
    extension: int,
    limit: TimeLimit,
    near: Near | None,
    enough: Callable[[Baseline], bool] | None,
    each: bool,
) -> Baseline:
    """As :func:`learn_baseline`.

    Args:
        recordings, system, length, progress, extension, limit, near, enough: As for :func:`learn_as_simulated`.
        each: Whether the floor is computed after each effect, so that one with which a log diverges is left out.

    Raises:
        FloorError: The simulation of a log diverges under what all of them tell, and ``each`` is False.
    """
    progress("healthy logs: refit")
    windows = cut_windows(recordings, system, length)
    windows = windows.take(moving(windows))
    start = replace(with_gauges_fixed(baseline_from(system, windows), windows), near=near)
    causes = shown_causes(catalogue(start.system.base), measured_channels(recordings))
    causes = [c for c in causes if not c.searched and c.free and not frees_scale(start, c)]
    usual = windows.steps
    windows, fit, accepted = _refit_with_delays(start, windows, causes)
    # Its steps suit further logs of the recorder, its values may not.
    step = windows.step if windows.steps > usual else start.step
    start = replace(start, near=Near({}, None, step) if math.isfinite(step) else None)
    # Run-to-run variation could be mistaken for an effect that all logs show, and such an effect for variation.
    spread = spread_of(Healthy(tuple(recordings), windows, start, tuple(accepted), fit))
    spread, told = spread.with_floor() if each else spread, spread.healthy
    alike: dict[str, tuple[str, ...]] = {c.name: (c.name,) for c in accepted}
    for _ in range(extension):
        fit, (counted, problem) = told.fit, told.counted()
        if not limit.allows("small effects that the healthy logs show"):
            break
        if enough is not None and (so_far := _so_far(told, spread)) is not None and enough(so_far):
            break
        progress(f"healthy logs: fitting every cause{in_company_of(c.name for c in accepted)}")
        hints = Hints(start.system, windows, missing_torque(problem, fit), fit.chi2 / windows.samples)
        # Small effects are sought, and none drives a refit far away.
        ranking = rank(problem, counted, fit, accepted, hints, causes, wanted=DETECTION, strong=False)
        if not ranking.candidates or ranking.best.delta_bic < DETECTION:
            break
        if is_of_any_machine(problem, counted, ranking):
            break
        ranking = front_settled(problem, counted, accepted, ranking, forms=False)
        best = ranking.best
        alike[best.cause.name] = equivalent(problem, counted, ranking, tuple(accepted))
        # A cause that imitated a mixture of others becomes superfluous once these are added. It is not tried again.
        causes = [c for c in causes if c.name != best.cause.name]
        accepted, fit = eliminated(problem, counted, [*accepted, best.cause], best.fit, DETECTION)
        # A missing effect increases the apparent run-to-run variance, so the variance is estimated again.
        try:
            fresh = spread_of(replace(told, causes=tuple(accepted), fit=fit))
            spread, told = fresh.with_floor() if each else fresh, fresh.healthy
        except DivergedError:
            # All logs together bear this effect, one of them alone does not: it is none that the unit has.
            accepted = list(told.causes)
    losing = _losing_commands(told, progress, limit)
    # If the healthy logs cannot decide between several causes, a later log may. So all of them are added, with the
    # uncertainty that the healthy logs leave.
    catalogued = catalogue(start.system.base)
    members = dict.fromkeys(name for cause in accepted for name in alike[cause.name])
    others = [catalogued[n] for n in members if kind_of(n) not in BENDING]
    others = [c for c in others if not c.searched and not frees_scale(start, c)]
    if {c.name for c in others}.difference(c.name for c in accepted):
        return extended(replace(start, healthy=told, losing=losing), others)
    try:
        spread = spread if each else spread.with_floor()
    except DivergedError as error:
        raise FloorError(str(error)) from error
    return replace(_learned(told, spread.runs), losing=losing)


def _losing_commands(healthy: Healthy, progress: Progress, limit: TimeLimit) -> LosingCommands:
    """Return of which commands healthy logs lose some, beside the effects that they are known to show."""

    def loses(index: int) -> bool:
        if not limit.allows("lost commands in the healthy logs"):
            return False
        progress(f"healthy logs: lost commands{in_company_of(c.name for c in healthy.causes)}")
        counted, problem = healthy.counted()
        known = catalogue(healthy.before.system.base).values()
        causes = [c for c in known if c.kind == LOST_COMMANDS.name and c.index == index]
        prior = prior_with(problem, counted, healthy.causes, healthy.fit.values)
        return best_losses(problem, healthy.fit, prior, causes, 1.0, DETECTION)[0] is not None

    return LosingCommands(loses)


def is_of_any_machine(problem: FitProblem, start: Baseline, ranking: Ranking) -> bool:
    """Return whether what explains most of healthy logs is no more than any healthy machine has.

    It would not be named for other logs either, so it need not be known. Millions of samples show a spring that gives a
    ten-thousandth of a joint's load. Causes that explain much less may be more than that, but they mostly imitate it.

    Args:
        problem: The healthy logs.
        start: Their baseline.
        ranking: Causes on these logs.
    """
    least = SHARE_OF_BEST * ranking.best.delta_bic
    leading = [c for c in ranking.candidates if c.delta_bic >= least and c.fit is not ranking.reference]
    return bool(leading) and all(
        tolerated(problem, start, c.cause, c.fit, ranking.deflation) for c in leading
    )


def _refit_with_delays(
    start: Baseline, windows: Windows, causes: Sequence[Cause]
) -> tuple[Windows, Fit, list[Cause]]:
    """Refit healthy logs of a robot from a model file beside delays of its commands and speeds.

    Its recorder has them nearly always. A speed that a drive has filtered for 3 ms leaves a thousand noise variances
    without its delay; other small effects then imitate it, and each costs a ranking. So these are asked for first.

    Args:
        start: The baseline, with the delays that the question of the simulator has found.
        windows: The windows.
        causes: Small effects that may be learned.

    Returns:
        The windows under the estimated noise, the refit, and the delays that it needs.
    """
    if start.near is None:
        return *refit_sharply(start, windows), []
    known = dict(start.near.delays or {})
    own, fit, kept = _refit_beside(start, windows, [c for c in causes if known.keys() & c.free], known)
    usual = {*DELAYS, delay_of_speeds(start.system, windows)}
    others = [c for c in causes if usual.issuperset(c.free) and c not in kept]
    if not others or fit.chi2 <= white_limit(own) * own.samples:
        return own, fit, kept
    problem, both = FitProblem(start.system, own), [*kept, *others]
    # Delays of a recorder are short: fits from long ones took 40 iterations instead of 4, to the same end.
    found = problem.fit([freed(problem, start, both, fit, fit.values)])[0]
    if found.diverged:
        return own, fit, kept
    needed, found = eliminated(problem, start, both, found, DETECTION, least=0)
    if len(needed) <= len(kept):
        return own, fit, kept
    # Steps and noise follow from what is left beside them.
    again = replace(start, near=start.near._replace(values=found.values))
    return _refit_beside(again, windows, needed, {n: found.values[n] for c in needed for n in c.free})


def _refit_beside(
    start: Baseline, windows: Windows, causes: Sequence[Cause], values: Mapping[str, float]
) -> tuple[Windows, Fit, list[Cause]]:
    """Refit beside some causes from these sizes, and return those of them that it needs."""
    if causes:
        at = {**start.values, **values}
        prior = prior_with(FitProblem(start.system, windows), start, causes, at)
        with contextlib.suppress(DivergedError):
            own, fit = refit_sharply(replace(start, values=at, prior=prior), windows)
            kept, fit = eliminated(FitProblem(start.system, own), start, causes, fit, DETECTION, least=0)
            return own, fit, kept
    return *refit_sharply(start, windows), []


def _so_far(healthy: Healthy, spread: Spread) -> Baseline | None:
    """Return the baseline with the effects that are known; None if a log diverges under what all of them tell."""
    try:
        return _learned(healthy, spread.with_floor().runs)
    except DivergedError:
        return None


def frees_scale(start: Baseline, cause: Cause) -> bool:
    """Return whether a cause changes the parameter that fixes a scale.

    What fixes a scale is a convention. Freed in healthy logs, it lets all parameters of that scale run away together.

    Args:
        start: A baseline.
        cause: The cause.
    """
    return is_changed(cause) and not {g.fixed for g in start.gauges}.isdisjoint(cause.free)


def extended(start: Baseline, causes: Sequence[Cause]) -> Baseline:
    """Add further causes to a learned baseline, with the values and uncertainty that its healthy logs give.

    Args:
        start: The baseline, learned from healthy logs.
        causes: Further causes.

    Raises:
        BaselineError: The baseline was not learned from logs.
    """
    healthy = start.healthy
    if healthy is None:
        raise BaselineError(
            "the baseline was not learned from healthy logs, so it cannot be extended; learn it with learn_baseline"
        )
    before, problem = healthy.counted()
    known = {c.name for c in healthy.causes}
    added = [c for c in causes if c.name not in known and not frees_scale(start, c)]
    if not added:
        return replace(_learned(healthy, start.runs), losing=start.losing)
    together = (*healthy.causes, *added)
    fit = problem.fit_one(freed(problem, before, together, healthy.fit, healthy.fit.values), PATIENCE)
    spread = spread_of(replace(healthy, causes=together, fit=fit)).with_floor()
    return replace(_learned(spread.healthy, spread.runs), losing=start.losing)


def _learned(healthy: Healthy, runs: RunToRun | None) -> Baseline:
    """Return the baseline of a diagnosis after these logs: values, prior, floor, correlation and effects."""
    start, fit = healthy.before, healthy.fit
    prior = prior_with(FitProblem(start.system, healthy.windows), start, healthy.causes, fit.values)
    if runs is None:
        pooled = dispersion(fit, healthy.windows)
        centre = np.array([fit.values[n] for n in prior.names])
        counted, problem = healthy.counted()
        told = posterior(
            fit, prior, pooled.deflation, prior_with(problem, counted, healthy.causes, fit.values)
        )
        learned = Prior(
            prior.names,
            centre,
            told + unshown(start.system, prior.names, fit.values, [g.fixed for g in start.gauges]),
        )
        floor, correlation = pooled.chi2_per_sample, 1.0
    else:
        learned = within_bounds(runs.of_another(prior), start.system)
        floor, correlation = runs.floor, runs.correlation
    learned = with_ratios(learned, start.system)
    return replace(
        start,
        values={**fit.values, **dict(zip(learned.names, learned.centre.tolist(), strict=True))},
        prior=learned,
        floor=max(1.0, floor),
        correlation=correlation,
        effects=tuple(dict.fromkeys(c.effect for c in healthy.causes if not is_changed(c))),
        healthy=healthy,
        runs=runs,
    )


def describe_healthy(start: Baseline) -> dict[str, Any] | None:
    """Return the results from healthy logs for the report; None where there are none."""
    if start.healthy is None:
        return None
    runs = start.runs
    varies = () if runs is None else np.sqrt(np.diag(runs.covariance))
    units = [start.system.parameter(n).unit for n in start.prior.names]
    return {
        "logs": len(start.healthy.recordings),
        "effects": list(start.effects),
        "chi2_per_sample": start.floor,
        "correlation": start.correlation,
        "run_to_run": {
            name: {"sd": float(sd), "unit": unit}
            for name, sd, unit in zip(start.prior.names, varies, units, strict=False)
        },
    }

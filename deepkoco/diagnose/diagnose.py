"""The whole diagnosis: from logs to named causes and their gain."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from deepkoco.diagnose.baseline import (
    Baseline,
    BaselineError,
    baseline_from,
    check_learned,
    with_gauges_fixed,
)
from deepkoco.diagnose.beside_healthy import BesideHealthy
from deepkoco.diagnose.between_rows import as_recorded
from deepkoco.diagnose.causes import catalogue, causes_named, measured_channels, shown_causes
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, cut_data
from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.explanation import Explanation, refitted
from deepkoco.diagnose.later_part import LaterPart
from deepkoco.diagnose.longer_windows import on_longer_windows
from deepkoco.diagnose.lost_rows import with_lost_rows_beside
from deepkoco.diagnose.probability.shadow import with_evidence
from deepkoco.diagnose.progress import Progress, silent
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.the_other_way import the_other_way
from deepkoco.diagnose.time_limit import TimeLimit
from deepkoco.diagnose.verdict.elastic_drives import with_elastic_drives
from deepkoco.diagnose.verdict.judgement import Judgement, judge
from deepkoco.diagnose.verdict.off_the_sheet import with_values_off_the_sheet
from deepkoco.diagnose.verdict.result import diagnosis_of, insufficient
from deepkoco.diagnose.verdict.shorter_windows import on_shorter_windows
from deepkoco.diagnose.weighed import explained
from deepkoco.diagnose.window_choice import followed_length, length_for_enough
from deepkoco.fit.compiling import told_of_compilation
from deepkoco.fit.data.windows import window_length
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.fit.threads import one_thread
from deepkoco.logs.held_values import with_held_values
from deepkoco.logs.lost_rows import with_lost_rows
from deepkoco.logs.read_logs import Logs, read_logs
from deepkoco.systems import ExtendedSystem, System, any_system
from deepkoco.systems.stretchable import stretchable_if_asked


def diagnose(
    recordings: Logs,
    system: str | System,
    healthy: Logs = (),
    holdout: Logs = (),
    seed: int = 0,
    window: float | None = None,
    detection: float = DETECTION,
    only: Sequence[str] | None = None,
    baseline: Baseline | None = None,
    progress: Progress = silent,
    evidence: bool = False,
    time_limit: float | None = None,
) -> Diagnosis:
    """Compare logs of a unit with its simulation, and name the cause of the difference.

    Every window of the logs is simulated under the logged commands from a free initial state. The
    baseline's own parameters are refitted within their priors. Each cause of the catalogue is then
    fitted on top of it and ranked by the BIC. The best one is accepted if the BIC falls enough; its class
    lists the causes that the data cannot distinguish from it. Forward selection adds further causes. The
    remaining structure decides between "nothing" and "unknown". Held-out windows (or logs) measure the gain.

    A single log may be of a unit that changed within it. Where a cause began then, the result is that of the part after
    the change, with the part before as a further healthy log, and its ``unexplained["changed_midway"]`` says when.
    This is not asked with ``holdout`` or ``baseline``.

    Args:
        recordings: Logs to explain: recordings, paths of logs, or folders of logs.
        system: Name of the system, or a system (plain, or loaded from model.yaml).
        healthy: Logs of the same unit in which nothing is wrong; like ``recordings``.
        holdout: Logs that are never fitted, like ``recordings``; without them, one window in four is held out.
        seed: Seed of the bootstrap.
        window: Length of a window [s]; None takes about one period of the system, or as much less as the system as
            given follows the logs.
        detection: Fall of the BIC from which a cause is named.
        only: Causes to try, by their names at this system; a name without a place (``coulomb``) stands for every
            joint, command or channel. None tries all that the logs can show.
        baseline: Result of :func:`learn_baseline` for healthy logs, instead of ``healthy``; several diagnoses can
            share it. None learns it from ``healthy``.
        progress: Called with the name of each step; ``print``, for example.
        evidence: Whether :mod:`deepkoco.diagnose.probability` answers too. It doubles the time and changes no verdict.
        time_limit: Time [s] after which no further step begins; the result is the best answer so far, and its
            ``left_out`` lists the steps that are missing. Only then the result depends on the speed of the machine. The
            first ranking of the causes is always made. None makes every step.

    Raises:
        LogError: A log cannot be read, or lacks a channel.
        UnknownSystemError: There is no such system.
        BaselineError: ``healthy`` and ``baseline`` are both given, or the baseline was learned on another system.
        UnknownCauseError: ``only`` names a cause that the system does not have.
        DivergedError: The simulation of the system as given diverges on these logs.
        TimeLimitError: ``time_limit`` is not positive.
    """
    began = time.perf_counter()
    base = stretchable_if_asked(any_system(system), only)
    recordings, healthy, holdout = as_read = [
        [with_held_values(with_lost_rows(log)) for log in read_logs(logs, base)]
        for logs in (recordings, healthy, holdout)
    ]
    plain = base.base if isinstance(base, ExtendedSystem) else base
    all_causes, measured = catalogue(plain, regrouping=True), measured_channels([*recordings, *holdout])
    causes = (
        shown_causes(all_causes, measured) if only is None else causes_named(all_causes, only, plain.name)
    )
    regrouping = [c for c in causes if c.regroups] if only is None else []
    causes = [c for c in causes if c not in regrouping]
    if baseline is not None and healthy:
        raise BaselineError(
            f"both a baseline and {len(healthy)} healthy logs are given; give either the logs or the baseline "
            "that was learned from them"
        )
    with one_thread(), told_of_compilation(progress):
        usual = window_length(base) if window is None else window
        limit = TimeLimit(time_limit, began=began)
        if baseline is not None:
            check_learned(baseline, base)
        progress("asking which simulator the logs are of")
        read = as_recorded(healthy or recordings, base, usual, baseline)
        base, (recordings, healthy, holdout) = read.system, map(read.logs, (recordings, healthy, holdout))
        chosen = window is not None or baseline is not None
        length = usual if chosen else followed_length(recordings, base, healthy)
        if window is None and baseline is None:
            length = length_for_enough(recordings, base, length, holdout)
        data = cut_data(recordings, holdout, base, length)
        request = DiagnosisRequest(
            recordings,
            base,
            data,
            length,
            seed,
            detection,
            causes,
            progress,
            began,
            evidence,
            limit,
            holdout,
            usual,
            regrouping,
        )
        if len(data.train) < MIN_TRAINING_WINDOWS:
            return insufficient(request)
        learned, unfitted, beside = baseline, (), BesideHealthy(request, healthy, read.near)
        ask = partial(
            diagnose, system=system, seed=seed, window=window, detection=detection, only=only, progress=progress,
            evidence=evidence,
        )  # fmt: skip
        whole = baseline is not None or len(recordings) != 1 or bool(holdout)
        later = None if whole else LaterPart(as_read[0][0], as_read[1], ask)
        if learned is None and healthy:
            try:
                learned = beside.learned()
            except DivergedError as error:
                unfitted = (f"the healthy logs, which are left out ({error})",)
        if learned is not None:
            try:
                return _diagnosed(request, learned, beside=beside, later=later)
            except DivergedError as error:
                # The healthy logs may be of another unit, so their prior need not suit these logs.
                unfitted = (f"these logs under the prior of the healthy logs, which are left out ({error})",)
                later = None if later is None else replace(later, healthy=())
        start = with_gauges_fixed(baseline_from(base, data.train), data.train)
        start = start if healthy else replace(start, near=read.near)
        return _diagnosed(request, start, unfitted, window is not None, later=later)


def _diagnosed(
    request: DiagnosisRequest,
    start: Baseline,
    unfitted: Sequence[str] = (),
    chosen: bool = True,
    beside: BesideHealthy | None = None,
    later: LaterPart | None = None,
) -> Diagnosis:
    """Diagnose from one baseline: refit it and select causes, judge them, and build the result.

    Args:
        request: The logs.
        start: The baseline.
        unfitted: What could not be fitted so far, in words.
        chosen: Whether somebody chose the length of the windows.
        beside: The healthy logs; None without any.
        later: The log, where a change of the unit in it may be looked for.
    """
    base = None if beside is None else beside.refit_of(start)
    if later is not None:
        base = refitted(request, start) if base is None else base
        if (found := later.diagnosed(request, base)) is not None:
            return replace(
                found, seconds=time.perf_counter() - request.began, time_limit=request.limit.seconds
            )
    found = _judged(start, request, unfitted, base)
    if beside is not None:
        found = beside.with_small_effects(found, partial(_judged, request=request, unfitted=unfitted))
    request, explanation, judgement = found
    explanation, judgement = with_values_off_the_sheet(request, explanation, judgement)
    request, explanation, judgement = with_elastic_drives(request, explanation, judgement)
    request, explanation, judgement = on_shorter_windows(request, explanation, judgement, unfitted, chosen)
    weighed = request.evidence and request.limit.allows("probabilities of the causes")
    result = diagnosis_of(request, explanation, judgement)
    return with_evidence(result, request, explanation.base, explanation.weights) if weighed else result


def _judged(
    start: Baseline, request: DiagnosisRequest, unfitted: Sequence[str], base: Refitted | None = None
) -> tuple[DiagnosisRequest, Explanation, Judgement]:
    """Select causes on one baseline, on longer windows where they allow that, and judge them.

    Args:
        start: The baseline.
        request: The logs.
        unfitted: What could not be fitted so far, in words.
        base: Its refit, where it is known.
    """
    explanation = explained(request, start, unfitted, base=base)
    request, explanation = with_lost_rows_beside(request, explanation, unfitted)
    request, explanation = the_other_way(request, explanation, unfitted)
    request, explanation = on_longer_windows(request, explanation)
    return request, explanation, judge(request, explanation)

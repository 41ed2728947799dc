"""Probabilities of causes straight from logs, without the rest of a diagnosis."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline, Healthy, Near, baseline_from, with_gauges_fixed
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue, causes_named, measured_channels, shown_causes
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.probability.answer import Answer
from deepkoco.diagnose.probability.healthy_unit import learned_unit
from deepkoco.diagnose.probability.shadow import probabilities
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.threads import one_thread
from deepkoco.logs.held_values import with_held_values
from deepkoco.logs.read_logs import Logs, read_logs
from deepkoco.logs.recording import LogError
from deepkoco.systems import ExtendedSystem, System, any_system


def evidence_of(
    recordings: Logs,
    system: str | System,
    healthy: Logs = (),
    window: float | None = None,
    only: Sequence[str] | None = None,
) -> Answer:
    """Return the probability of every cause for these logs.

    Args:
        recordings: Logs to explain, as for :func:`deepkoco.diagnose.diagnose`.
        system: The system as given, or its name.
        healthy: Logs of the same unit in which nothing is wrong.
        window: Length of a window [s]; None takes about one period of the system.
        only: Causes to try; None tries all that the logs can show.

    Raises:
        LogError: A log cannot be read, or shows no motion.
        DivergedError: The simulation of the system as given diverges.
    """
    began = time.process_time()
    base = any_system(system)
    plain = base.base if isinstance(base, ExtendedSystem) else base
    length = window_length(base) if window is None else window
    with one_thread():
        logs, every = [with_held_values(log) for log in read_logs(recordings, base)], catalogue(plain)
        shown = shown_causes(every, measured_channels(logs))
        causes = shown if only is None else causes_named(every, only, plain.name)
        data = cut_data(logs, (), base, length)
        if len(data.train) == 0:
            raise LogError(
                "the logs to explain show no window of motion; give a log in which the joint moves"
            )
        if not healthy:
            start = with_gauges_fixed(baseline_from(base, data.train), data.train)
            unit = None
        else:
            told = _healthy([with_held_values(log) for log in read_logs(healthy, base)], base, length)
            # The recorder is that of the healthy logs.
            start = replace(told.before, near=Near({}, told.windows.wander))
            unit = learned_unit(told, causes)
        windows, reference = refit_sharply(start, data.train)
        problem = FitProblem(start.system, windows)
        answer = probabilities(problem, reference, start, causes, unit)
    return replace(answer, seconds=time.process_time() - began)


def _healthy(recordings: Sequence, base: System, length: float) -> Healthy:
    """Return healthy logs with the system as given, refitted to all of them."""
    windows = cut_windows(recordings, base, length)
    moves = moving(windows) if len(windows) else np.zeros(0, dtype=bool)
    if not moves.any():
        raise LogError("the healthy logs show no window of motion; give a log in which the joint moves")
    windows = windows.take(moves)
    start: Baseline = with_gauges_fixed(baseline_from(base, windows), windows)
    windows, fit = refit_sharply(start, windows)
    return Healthy(tuple(recordings), windows, start, (), fit)

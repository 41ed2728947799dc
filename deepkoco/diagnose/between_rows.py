"""Whether the rows of logs show the commands of a faster controller, which act around them and not from them on."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.as_engine import as_engine_if_shown, closest_of_logs
from deepkoco.diagnose.baseline import Baseline, Near, baseline_from
from deepkoco.diagnose.baseline_refit import from_shorter_windows, on_half_windows, slopes_on_half_windows
from deepkoco.diagnose.late_speeds import with_late_speeds
from deepkoco.diagnose.left_of_logs import ENOUGH
from deepkoco.diagnose.residuals.residuals import white_limit
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import Windows, cut_windows, moving
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.command_noise import with_command_noise, with_noise_like
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.fine_steps import with_steps_of
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.between_rows import changes_often, with_early_commands
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

SOME = 10  # windows that decide
FURTHER = 16  # iterations of a fit that begins at the end of another one
EVIDENCE = 10.0  # fall of minus twice the log likelihood from which commands act around rows
CLEARLY = 30.0  # of it, from which it is an engine that has commands early
EARLIEST = 0.5  # rows by which the commands of a faster controller act before their row at most
LATER = 0.65  # rows by which commands may act early instead, as those do whose stamps are late
FURTHER_LEADS, SAME = 2, 0.03  # that find the lead; difference of leads that hardly matters [rows]

log = logging.getLogger(__name__)


class Read(NamedTuple):
    """How logs are read.

    Attributes:
        system: The system as what made the logs simulates it.
        early: Time by which commands act before their rows [s].
        near: What the fits that told this tell of further ones; None for nothing.
    """

    system: System
    early: float
    near: Near | None = None

    def logs(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Return logs with commands from the instants at which they act."""
        return [with_early_commands(log, self.early) for log in recordings]


def as_recorded(
    recordings: Sequence[Recording], system: System, length: float, learned: Baseline | None = None
) -> Read:
    """Return from when on the commands of logs act, and what made the logs.

    An engine of a model file has commands half a step early, too. So the logs choose between both. They are not asked
    where a law with commands from their rows on leaves only noise, and as little as any engine.

    Args:
        recordings: Logs of one recorder.
        system: The system.
        length: Of the windows [s].
        learned: Baseline from healthy logs, which have decided; None for none.
    """
    if learned is not None:
        return Read(as_engine_if_shown(recordings, system, length, learned), learned.early)
    found = closest_of_logs(recordings, system, length)
    left_of_held, as_held = found.left, Read(found.system, 0.0, found.near)
    if found.lead > 0.0:
        return Read(found.system, found.lead, found.near)
    if found.on_time is not None and not found.early:
        return as_held
    on_time = system if found.on_time is None else found.on_time
    early = lead_of_commands(recordings, on_time, length, found.near)
    if early == 0.0:
        return as_held
    moved = [with_early_commands(own, early) for own in recordings]
    around = closest_of_logs(moved, system, length, found.near)
    left_of_around, as_around = around.left, Read(around.system, early + around.lead, around.near)
    log.debug("from their rows on %s, around them %s", left_of_held, left_of_around)
    if left_of_held is None or left_of_around is None:
        return as_around
    # The steps of an engine are chosen, too, and act as such a lead does. Both are asked on windows of their own.
    samples = left_of_held.cost / max(left_of_held.per_sample, 1e-12)
    gain = samples * (left_of_around.per_sample / max(left_of_held.per_sample, 1.0) - 1.0)
    return as_held if gain > CLEARLY else as_around


def lead_of_commands(
    recordings: Sequence[Recording], system: System, length: float, near: Near | None = None
) -> float:
    """Return the time [s] by which commands act before their rows; 0 where refits leave no less for it that counts.

    A lead of more than half a row is none of a faster controller: the stamps are late, which is another thing.

    Args:
        recordings: Logs of one recorder.
        system: The system.
        length: Of the windows [s].
        near: What earlier fits of the logs have told; None for none.
    """
    windows = cut_windows(recordings, system, length)
    windows = windows.take(moving(windows)) if len(windows) else windows
    if not len(windows):
        return 0.0
    rows = [float(np.median(np.diff(c.t))) for c in windows.commands if c.changes and len(c.t) > 2]
    often = all(changes_often(c.value) for c in windows.commands if c.changes)
    if not rows or not often or not all(map(_is_row_of_samples, recordings)):
        return 0.0
    windows = windows.take(np.unique(np.linspace(0, len(windows) - 1, SOME).astype(int)))
    try:
        start = with_late_speeds(replace(baseline_from(system, windows), near=near), windows)
        return _lead(start, windows, float(np.median(rows)))
    except DivergedError:
        return 0.0


def _is_row_of_samples(recording: Recording) -> bool:
    """Whether commands and measurements are columns of the same rows."""
    channels = [recording.channels[n] for n in recording.names("command")]
    shown = [recording.channels[n].t for n in recording.names("measurement")]
    return all(any(np.array_equal(own.t, t) for t in shown) for own in channels)


def _lead(start: Baseline, windows: Windows, row: float) -> float:
    """Return the lead [s] of commands that are logged every row [s]."""
    names, problem_of = start.prior.names, partial(FitProblem, start.system)
    asked, start, windows = start.near is not None, start.begun(), with_steps_of(windows, start.step)
    windows = with_noise_like(problem_of, windows, start.values, start.wander)
    held = (on_half_windows if asked else from_shorter_windows)(start, windows, names)
    if held.chi2 <= white_limit(windows) * windows.samples:
        return 0.0
    start = replace(start, values={**start.values, **{n: held.values[n] for n in names}})
    state = windows.state.clone()
    state[:] = held.state[::2]
    noisy = windows
    if windows.wander is None:
        noisy = with_command_noise(problem_of, windows, held.values, state)
    if noisy is not windows:
        # The same noise for all: what is left of each is then compared in the same measure.
        windows = noisy
        held = on_half_windows(start, windows, names, FURTHER, ENOUGH)

    # Fits with a lead end a little earlier than the one without, so that a lead is believed rather less.
    slopes = slopes_on_half_windows(start, windows, held)

    def left(rows: float) -> Fit:
        moved = tuple(replace(c, t=c.t - rows * row) for c in windows.commands)
        return on_half_windows(start, replace(windows, commands=moved), names, FURTHER, ENOUGH, slopes)

    fits = {share: left(share) for share in (0.5 * EARLIEST, EARLIEST)}
    costs = {0.0: held.chi2, **{share: fit.chi2 for share, fit in fits.items()}}
    best = min(fits.values(), key=lambda fit: fit.chi2)
    spread = dispersion(best, halved(windows))
    counts = max(spread.chi2_per_sample, 1.0) * spread.correlation
    log.debug("by rows %s", costs)
    if held.chi2 - best.chi2 < EVIDENCE * counts or left(LATER).chi2 < best.chi2:
        return 0.0
    rows = _least(costs)
    for _ in range(FURTHER_LEADS):
        if any(abs(rows - own) < SAME for own in costs):
            break
        costs[rows] = left(rows).chi2
        rows = _least(costs)
    log.debug("by rows %s: %.3g", costs, rows)
    return rows * row


def _least(costs: Mapping[float, float]) -> float:
    """Return the lead of least cost on a parabola through the three best ones."""
    near = sorted(costs, key=lambda each: costs[each])[:3]
    curvature, slope, _ = np.polyfit(near, [costs[each] for each in near], 2)
    return float(np.clip(-0.5 * slope / curvature, 0.0, EARLIEST)) if curvature > 0.0 else near[0]

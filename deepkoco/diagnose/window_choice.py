"""Length of the windows: about one period of the system, or less where the simulation as given leaves the logs.

A cause is found by its slope at the refit. Where the simulation has left the motion within a window, that slope says
nothing, the cost has many minima, and a refit ends in one of them with parameters that no machine has. Along a short
window the state is nearly known, and its change is nearly linear in loads and masses.

Source: Bock, Recent advances in parameter identification (1983), on the length of the intervals of multiple shooting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor

from deepkoco.diagnose.baseline import Baseline, baseline_from
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, SPARED
from deepkoco.fit.data.windows import Windows, cut_windows, estimate_channels, moving, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

SHARES = (1.0, 0.5, 0.25, 0.125)  # of the usual length
# An unstable plant in closed loop, such as a ball below a magnet, leaves its log within a small part of the usual
# length for any error of a parameter. Shorter windows are tried where errors exceed the whole motion in all others.
SHORTER = (0.0625, 0.03125, 0.015625)
LOST = 1.0  # squared error, as a share of the motion
FOLLOWS = 0.1  # squared error of a simulation, as a share of the motion in its window, up to which it follows its log
# Squared error, as a share of the motion, above which a simulation runs away: no error of a stable plant is ten times
# its motion. Initial states that keep it near are then a needle's eye, in which a fit gets stuck.
RUNS_AWAY = 100.0
FEW = 0.1  # share of the windows that may run away: a push may throw a simulation off
MUCH = 100.0  # noise variances that a simulation leaves from which its slopes are doubted
SOME = 20  # windows that are simulated
PERIODS = (
    2.5  # usual windows that the logs last, at least, to be cut into shorter ones: one motion shows no law
)
SHORTEST = 16  # samples of each channel that a window keeps


def followed_length(
    recordings: Sequence[Recording], system: System, healthy: Sequence[Recording] = ()
) -> float:
    """Return the longest window [s] in which the system as given follows most of the logs.

    In few of them may it run away. Where it follows them in none, the window that it leaves least. Healthy logs show
    what the unit does, and their baseline follows it in a window of usual length, but for one in which their simulation
    as given leaves more than their whole motion: no fit leads back from there.

    Args:
        recordings: Logs to explain.
        system: The system as given.
        healthy: Healthy logs of the unit; none where the system as given has to follow the logs to explain.
    """
    recordings = healthy or recordings
    usual, noise = window_length(system), estimate_channels(recordings, system)
    least, best = np.inf, usual
    for share in (*SHARES, *SHORTER):
        if share in SHORTER and least <= LOST:
            break
        windows = cut_windows(recordings, system, share * usual, noise)
        windows = windows.take(moving(windows)) if len(windows) else windows
        if len(windows) == 0 or samples_of(windows) < SHORTEST:
            break
        start = baseline_from(system, windows)
        error, motion = _errors_and_motions(windows, start, start.values)
        left = float((error / motion).median())
        # Where friction holds the unit, a simulation that slides is far off by the little motion of that window alone.
        away = float((error / motion.clamp_min(float(motion.median()))).quantile(1.0 - FEW)) > RUNS_AWAY
        if left <= (LOST if healthy and share == 1.0 else FOLLOWS) and not away:
            return share * usual
        # Where the simulation follows no window, those that run away are no sign of an unstable plant.
        if left < least and not (away and left <= LOST):
            least, best = left, share * usual
    return best


def length_for_enough(
    recordings: Sequence[Recording], system: System, length: float, holdout: Sequence[Recording] = ()
) -> float:
    """Return the length where the logs give enough moving windows to fit, else the longest of its half and quarter.

    A bench records motions of a few seconds, which have fewer periods than a diagnosis needs windows. Where the logs
    have fewer than ``PERIODS`` of them, the length stays as it is, and they do not suffice. A shorter length gives
    enough windows to hold some out too; where none does, the one counts that gives enough to fit.

    Args:
        recordings: Logs to explain.
        system: The system as given.
        length: Usual length of a window [s].
        holdout: Logs that are never fitted; with them no window is held out.
    """
    noise, fitted = estimate_channels(recordings, system), None
    seconds = sum(recording.stop - recording.start for recording in recordings)
    for share in SHARES[:3] if seconds > PERIODS * length else ():
        windows = cut_windows(recordings, system, share * length, noise, cover=bool(holdout))
        count = int(moving(windows).sum()) if len(windows) else 0
        if count and samples_of(windows) < SHORTEST:
            break
        if count >= MIN_TRAINING_WINDOWS + (0 if holdout or share == 1.0 else SPARED):
            return share * length
        if fitted is None and count >= MIN_TRAINING_WINDOWS:
            fitted = share * length
    return length if fitted is None else fitted


def samples_of(windows: Windows) -> int:
    """Samples of a full window, of the slowest channel that the logs measure."""
    most = windows.valid.sum(-1).max(0).values
    return int(most[most > 0].min())


def left_out(windows: Windows, start: Baseline, values: Mapping[str, float]) -> float:
    """Return the median over windows of the squared error, as a share of the motion, with fitted initial states.

    Args:
        windows: Windows; an even choice of them is simulated.
        start: Baseline of the system.
        values: Values of all parameters.
    """
    error, motion = _errors_and_motions(windows, start, values)
    return float((error / motion).median())


def _errors_and_motions(
    windows: Windows, start: Baseline, values: Mapping[str, float]
) -> tuple[Tensor, Tensor]:
    """Squared errors and motions (W,) of some windows, in noise variances."""
    some = windows.take(np.unique(np.linspace(0, len(windows) - 1, SOME).astype(int)))
    problem = FitProblem(start.system, some)
    _, cost = problem.fit_states(values, some.state)
    value, valid = some.value, some.valid
    mean = (value * valid).sum(-1, keepdim=True) / valid.sum(-1, keepdim=True).clamp_min(1)
    motion = ((value - mean) * problem.weight).square().sum((1, 2))
    return cost.nan_to_num(np.inf, np.inf), motion.clamp_min(1e-300)

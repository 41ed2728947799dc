"""Data of a diagnosis: training windows, held-out windows, and a description of their logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.fit.data.windows import Windows, cut_windows, estimate_channels, moving
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

MIN_TRAINING_WINDOWS = 4
SPARED = 2  # windows beyond these from which on some are held out
ENOUGH_WINDOWS = (
    36  # for up to twice as many parameters; more parameters have half as many windows as their number
)
HELD_OUT = 4  # without hold-out logs, one window in four is held out
# Mean squared difference of windows one stride apart over that of any two: a log below it repeats with the stride.
REPEATED = 0.2


@dataclass(frozen=True)
class Data:
    """Windows of one diagnosis.

    Attributes:
        train: Training windows.
        held: Held-out windows; None without any.
        resting: Number of windows that were left out because the joint rests.
        own: Whether the held-out windows are from the same logs as the training windows.
        spare: Number of windows that were left out because fewer tell enough about many parameters.
    """

    train: Windows
    held: Windows | None
    resting: int
    own: bool
    spare: int = 0

    def varying(self, varies: Mapping[str, float]) -> Data:
        """Return the data of a unit whose parameters vary from log to log by these standard deviations.

        Held-out windows of fitted logs use the fitted parameters of their log instead.
        """
        held = None if self.held is None else replace(self.held, varies={} if self.own else varies)
        return replace(self, train=replace(self.train, varies=varies), held=held)


def cut_data(
    recordings: Sequence[Recording], holdout: Sequence[Recording], system: System, length: float
) -> Data:
    """Cut logs into windows; windows in which the joint rests are left out."""
    noise = estimate_channels(recordings, system)
    # With hold-out logs, training windows may overlap: none of them is used for testing.
    windows = cut_windows(recordings, system, length, noise, cover=bool(holdout))
    moves = moving(windows) if len(windows) else np.zeros(0, dtype=bool)
    order = np.cumsum(moves) - 1  # among the windows that are used
    enough = moves.sum() >= MIN_TRAINING_WINDOWS + SPARED
    keep_back = moves & _held_out(windows, order) & (not holdout) & enough
    train = windows.take(moves & ~keep_back)
    if holdout:
        held = cut_windows(holdout, system, length, estimate_channels(holdout, system), cover=True)
    else:
        held = windows.take(moves & keep_back) if keep_back.any() else None
    count = len(train) + (0 if held is None else len(held))
    train = _enough(train, system)
    held = None if held is None else _enough(held, system)
    spare = count - len(train) - (0 if held is None else len(held))
    return Data(train, held, int((~moves).sum()), not holdout, spare)


def _enough(windows: Windows, system: System) -> Windows:
    """Return an even choice of windows where there are more than a system of many parameters needs.

    The time of a diagnosis grows with the number of windows times that of parameters and of causes to try. It must not
    grow with the length of the logs too.
    """
    parameters = len([p for p in system.parameters if "." not in p.name])
    most = max(ENOUGH_WINDOWS, parameters // 2)
    if parameters + windows.state.shape[1] < MANY or len(windows) <= most:
        return windows
    return windows.take(np.unique(np.linspace(0, len(windows) - 1, most).astype(int)))


def _held_out(windows: Windows, order: np.ndarray) -> np.ndarray:
    """Choose the windows to hold out.

    A log often repeats one motion. Where its period is as long as ``HELD_OUT`` windows, every held-out window would
    show the same phase, and no training window would. Then the place in each group moves on from group to group.

    Args:
        windows: All windows.
        order: (W,) number of each window among those that are used.
    """
    step = np.zeros(len(order), dtype=int)
    if len(windows) and _repeats(windows, HELD_OUT):
        step = order // HELD_OUT
    return order % HELD_OUT == (HELD_OUT - 1 - step) % HELD_OUT


def _repeats(windows: Windows, stride: int) -> bool:
    """Return whether windows a stride apart in the same log show nearly the same motion."""
    apart, alike = 0.0, 0.0
    for c in range(windows.value.shape[1]):
        samples = int(windows.valid[:, c].sum(-1).min()) if len(windows) else 0
        if samples == 0:
            continue
        value = windows.value[:, c, :samples].numpy()
        spread = float(value.var())
        same = windows.log[stride:] == windows.log[:-stride]
        if spread > 0.0 and same.any():
            apart += 1.0
            alike += float(((value[stride:] - value[:-stride])[same] ** 2).mean()) / (2.0 * spread)
    return apart > 0.0 and alike / apart < REPEATED


def describe_data(recordings: Sequence[Recording], data: Data, system: System) -> dict:
    """Return files, lengths, noise and windows for the report, and what the system leaves out of its file."""
    logs = []
    for recording in recordings:
        logs.append(
            {
                "file": recording.path.name if recording.path else None,
                "seconds": recording.stop - recording.start,
                "samples": {name: len(series) for name, series in recording.channels.items()},
                "warnings": list(recording.warnings),
            }
        )
    return {
        "logs": logs,
        "model": list(system.notes),
        "noise_sd": [n.sd for n in data.train.noise],
        "windows_resting": data.resting,
        "windows_spare": data.spare,
        "windows_held_out": 0 if data.held is None else len(data.held),
    }

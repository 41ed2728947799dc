"""Whether a unit is, until some time in its log, the one that its parameters describe, and then no longer.

A brake that begins to drag, a load that is picked up or a supply that sags has a log of two units. What lasts in the
later one is found beside the former one as a healthy log: in the whole log nothing lasts.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, SPARED
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.levenberg_marquardt import TO_BEGIN
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.part import seconds

FEWEST = 3  # fitted windows of the former unit
FEWEST_STEPS = 20  # of a window
NEAR = 5.0  # noise variances, beside the floor of the unit, up to which a window is explained
EXPLAINED = 10.0  # times by which the later unit's error is larger, under the parameters of the former one
MOSTLY = 0.75  # share of the later windows that these parameters do not explain
DIVERGED = 1e12  # noise variances of a window whose simulation diverges
ROUNDS = 4  # fits of the former unit at most, each of as many windows as the one before explains


class Change(NamedTuple):
    """A change of the unit within its log.

    Attributes:
        after_s: End of the last window that the former unit explains [s].
        until_s: End of the first one that it does not explain [s].
        fall: Times by which the former unit's parameters explain its own part better than the later one.
        near: Mean squared error of the former part under its own parameters [noise variances].
    """

    after_s: float
    until_s: float
    fall: float
    near: float

    @property
    def text(self) -> str:
        """What happened and when, as a clause."""
        return what_changed(self.after_s, self.until_s)

    def to_json(self) -> dict[str, Any]:
        """Return the change for `unexplained.changed_midway` of report.json."""
        return {"after_s": self.after_s, "until_s": self.until_s, "fall": self.fall, "text": self.text}


def what_changed(after_s: float, until_s: float, surely: bool = True) -> str:
    """Return as a clause that a unit changed, and when.

    Args:
        after_s: Time after which it did [s].
        until_s: Time until which it did [s].
        surely: Whether both parts are explained.
    """
    changed = "changed" if surely else "may have changed"
    return (
        f"the unit {changed} in the middle of this log, between {seconds(after_s)} and {seconds(until_s)} s"
    )


def change_within(start: Baseline, train: Windows, held: Windows | None, whole: Fit) -> Change | None:
    """Return when a unit changed that its parameters explain up to then, and hardly anywhere afterwards.

    The first quarter of the fitted windows is fitted, and then as many as one fit after the other explains. The first
    window that is not explained contains the change. A cause that lasts can be imitated by parameters, but not in
    windows that are not fitted, so one of these must be explained before the change.

    Args:
        start: Prior and present values of the parameters.
        train: Fitted windows.
        held: Held-out windows of the same log; None where there are none.
        whole: Fit of all fitted windows.

    Returns:
        The change; None where noise alone is left, for several logs, for few windows, where the first windows are not
        explained, where most of the later ones are, and where a simulation diverges.
    """
    if held is None or len(held) == 0 or len({*train.log.tolist(), *held.log.tolist()}) != 1:
        return None
    if more_than_noise(whole, train, start) is None:
        return None
    while len(train) < 4 * FEWEST and train.steps >= 2 * FEWEST_STEPS:
        train, held = halved(train), halved(held)
    order = np.argsort(train.t0)
    count = max(len(order) // 4, FEWEST)
    if len(order) < count + MIN_TRAINING_WINDOWS:
        return None
    begin = np.concatenate([train.t0, held.t0])
    last_quarter, foretold = begin >= np.sort(train.t0)[-count], False
    for _ in range(ROUNDS):
        part = train.take(np.sort(order[:count]))
        found = _former(start, part, (train, held), last_quarter)
        if found is None:
            return None
        bad = found.bad & (begin > part.t0.max())
        if not bad.any():
            return None
        change = float(begin[bad].min())
        foretold |= bool(((begin > part.t0.max()) & (begin < change)).any() or (held.t0 < change).any())
        reached = int((train.t0 < change).sum())
        if reached <= count:
            break
        count = reached
    before, after = begin < change, begin > change
    if after.sum() < MIN_TRAINING_WINDOWS + SPARED or bad[after].mean() < MOSTLY:
        return None
    fall = float(np.median(found.left[after]) / max(found.left[before].mean(), 1e-300))
    if not (foretold and fall > EXPLAINED):
        return None
    # Windows in which a joint rests are missing.
    return Change(float(begin[before].max()) + train.length, change + train.length, fall, found.near)


class _Former(NamedTuple):
    """What the parameters of some first windows leave.

    Attributes:
        near: Mean squared error of these windows [noise variances].
        left: (N,) the same of each window of the log.
        bad: (N,) whether an error is nearer, on a logarithmic scale, to those of the last quarter than to ``near``.
    """

    near: float
    left: np.ndarray
    bad: np.ndarray


def _former(
    start: Baseline, part: Windows, all_windows: tuple[Windows, Windows], last_quarter: np.ndarray
) -> _Former | None:
    """Fit some first windows; None where this does not explain them, or diverges.

    Args:
        start: Prior and present values of the parameters.
        part: The windows to fit.
        all_windows: Fitted and held-out windows of the log, N together.
        last_quarter: (N,) which of them are the last ones.
    """
    try:
        fit = refit(start, part, tolerance=TO_BEGIN)
    except DivergedError:
        return None
    near = fit.chi2 / part.samples
    if not near <= NEAR * start.floor:
        return None
    left = np.concatenate([_left(start, windows, fit) for windows in all_windows])
    later = left[last_quarter & (left < DIVERGED)]
    level = float(np.median(later)) if len(later) else DIVERGED
    return _Former(near, left, left > max(NEAR * start.floor, math.sqrt(near * level)))


def _left(start: Baseline, windows: Windows, fit: Fit) -> np.ndarray:
    """Return the mean squared error (W,) of W windows under a fit's parameters [noise variances].

    It is ``DIVERGED`` at most, also where the simulation of a window diverges.
    """
    _, cost = FitProblem(start.system, windows).fit_states(fit.values, windows.state)
    samples = windows.valid.flatten(1).sum(1).clamp_min(1)
    left = np.nan_to_num((cost / samples).numpy(), nan=DIVERGED, posinf=DIVERGED)
    return np.minimum(left, DIVERGED)

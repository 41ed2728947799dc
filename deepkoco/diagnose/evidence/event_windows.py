"""Windows in which something pushed the joint: they are fitted, and what lasts is measured on the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial

SUSPECT = 30.0  # fall of chi2 by a push in one slot, far beyond the largest that chance makes of all slots
STAND_OUT = 4.0  # times the fall that a push brings in a typical window
MIN_OTHER_WINDOWS = 3  # windows without the push, to refit on


def train_on_pushed(
    start: Baseline, train: Windows, held: Windows, reference: Fit
) -> tuple[Windows, Windows, Fit]:
    """Move windows that a push stands out in from those kept back to those that are fitted.

    A push is in one window, and a window that nobody fits shows nothing. It says nothing about what lasts either,
    so it is of no use among those kept back.

    Args:
        start: The baseline.
        train: Windows that are fitted.
        held: Windows that are kept back, of the same logs.
        reference: Refit of the baseline on ``train``.

    Returns:
        Both sets of windows and the refit, as they were if nothing stands out.
    """
    fitted = FitProblem(start.system, train)
    seen = _largest(fitted, reference)
    problem = FitProblem(start.system, fitted.elsewhere(held, reference))
    unfitted = problem.evaluate(reference.values, "held back")
    found = _largest(problem, unfitted)
    pushed = found > max(SUSPECT, STAND_OUT * float(np.median(seen)))
    # Where many windows stand out it is no push, and the gain needs some that were kept back.
    if not pushed.any() or pushed.sum() > max(len(held) // 3, 1) or pushed.all():
        return train, held, reference
    both = _joined(train, held.take(pushed))
    state = torch.cat([reference.state, unfitted.state[torch.from_numpy(np.flatnonzero(pushed))]])
    order = np.lexsort((both.t0, both.log))
    both, state = both.take(order), state[torch.from_numpy(order)]
    trial = Trial("refit", reference.free, start.prior, reference.values, state, reference.nuisance)
    return both, held.take(~pushed), FitProblem(start.system, both).fit_one(trial)


def touched(windows: Windows, values: Mapping[str, float]) -> np.ndarray:
    """(W,) whether the push in these parameter values acts during each window."""
    begin = values["event.start"]
    end = begin + values["event.duration"]
    during = (windows.t0 < end) & (windows.t0 + windows.length > begin)
    return (windows.log == values["event.log"]) & during


def refit_elsewhere(start: Baseline, windows: Windows, reference: Fit, pushed: Fit) -> Fit:
    """Refit of the baseline on the windows that a push does not touch.

    A refit that knows of no push bends its parameters to it; taking the push into account would then seem to improve
    every other window as well.

    Args:
        start: The baseline.
        windows: Windows that are fitted.
        reference: Refit on all of them.
        pushed: Fit with the push, on all of them.

    Returns:
        The reference itself where too few windows are left.
    """
    keep = ~touched(windows, pushed.values)
    if keep.sum() < MIN_OTHER_WINDOWS:
        return reference
    state = pushed.state[torch.from_numpy(np.flatnonzero(keep))]
    trial = Trial("refit", reference.free, start.prior, reference.values, state, reference.nuisance)
    return FitProblem(start.system, windows.take(keep)).fit_one(trial)


def _largest(problem: FitProblem, fit: Fit) -> np.ndarray:
    """(W,) largest fall of chi2 that a push in one slot of each window brings, over the joints."""
    return np.max([missing.score.max(1) for missing in missing_torque(problem, fit)], axis=0)


def _joined(a: Windows, b: Windows) -> Windows:
    return replace(
        a,
        log=np.concatenate([a.log, b.log]),
        t0=np.concatenate([a.t0, b.t0]),
        t=torch.cat([a.t, b.t]),
        value=torch.cat([a.value, b.value]),
        valid=torch.cat([a.valid, b.valid]),
        state=torch.cat([a.state, b.state]),
        rests=np.concatenate([a.rests, b.rests]),
    )

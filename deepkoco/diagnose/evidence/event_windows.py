"""Windows in which something happens once: they are fitted, and lasting causes are measured on the other windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.residuals.residuals import MissingTorque, missing_torque
from deepkoco.fit.data.wander import joined
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import QUIET
from deepkoco.systems.effects import SENSOR_SHIFT

MIN_FALL = 30.0  # fall of chi2 by a push in one slot, far above the largest fall by chance over all slots
MIN_SHARE = (
    0.5  # share of a window's chi2 that a step of a zero explains; of a model error it explains little
)
MIN_RATIO = 4.0  # that fall, over the fall in a typical window
MIN_OTHER_WINDOWS = 3  # windows without the push that a refit needs


def train_on_pushed(
    start: Baseline, train: Windows, held: Windows, reference: Fit
) -> tuple[Windows, Windows, Fit]:
    """Move held-out windows in which a push, or a step of a sensor's zero, stands out to the fitted windows.

    No other window shows that push, so it can only be found if its window is fitted. Such a window also cannot
    measure lasting causes. The step of a zero shows in all later windows, and its time in one of them only.

    Args:
        start: The baseline.
        train: Fitted windows.
        held: Held-out windows of the same logs.
        reference: Refit of the baseline on ``train``.

    Returns:
        Fitted windows, held-out windows and the refit; unchanged if nothing stands out.
    """
    fitted = FitProblem(start.system, train)
    seen = missing_torque(fitted, reference)
    problem = FitProblem(start.system, fitted.elsewhere(held, reference))
    unfitted = problem.evaluate(reference.values, "held back")
    found = missing_torque(problem, unfitted)
    left = unfitted.residual.square().sum((1, 2)).numpy()
    stepped = _apart(_steps(seen), _steps(found)) & (_steps(found) > MIN_SHARE * left)
    pushed = _few(_apart(_pushes(seen), _pushes(found))) | _few(stepped)
    if not pushed.any() or pushed.all():
        return train, held, reference
    both = _joined(train, held.take(pushed))
    state = torch.cat([reference.state, unfitted.state[torch.from_numpy(np.flatnonzero(pushed))]])
    order = np.lexsort((both.t0, both.log))
    both, state = both.take(order), state[torch.from_numpy(order)]
    trial = Trial("refit", reference.free, start.prior, reference.values, state, reference.nuisance)
    return both, held.take(~pushed), FitProblem(start.system, both).fit_one(trial)


def touched(windows: Windows, values: Mapping[str, float]) -> np.ndarray:
    """Return (W,) whether the push with these parameter values acts during each window."""
    begin = values["event.start"]
    end = begin + values["event.duration"]
    during = (windows.t0 < end) & (windows.t0 + windows.length > begin)
    return (windows.log == values["event.log"]) & during


def as_in(held: Windows, values: Mapping[str, float], fitted: Windows) -> dict[str, float]:
    """Return parameters for held-out windows: what happens once acts in those of its log too, and in no other log.

    A push for some seconds begins in one window and ends in a later one; one between them may be held out.

    Args:
        held: The held-out windows.
        values: All parameters of a fit.
        fitted: The windows that were fitted.
    """
    if of_same_logs(held, fitted):
        return dict(values)
    moved = [n for n in values if n.startswith(SENSOR_SHIFT.name) and n.endswith(".angle")]
    return {**values, **QUIET, **dict.fromkeys(moved, 0.0)}


def of_same_logs(a: Windows, b: Windows) -> bool:
    """Return whether two sets of windows were cut from the same logs."""
    return len(a.commands) == len(b.commands) and all(
        mine.t is theirs.t for mine, theirs in zip(a.commands, b.commands, strict=True)
    )


def refit_elsewhere(start: Baseline, windows: Windows, reference: Fit, pushed: Fit) -> Fit:
    """Refit the baseline on the windows that a push does not touch.

    A refit on all windows moves its parameters to imitate the push. A model with the push would then seem to improve
    every other window as well.

    Args:
        start: The baseline.
        windows: Fitted windows.
        reference: Refit on all of them.
        pushed: Fit with the push, on all of them.

    Returns:
        The refit; ``reference`` where too few windows are left.
    """
    keep = ~touched(windows, pushed.values)
    if keep.sum() < MIN_OTHER_WINDOWS:
        return reference
    state = pushed.state[torch.from_numpy(np.flatnonzero(keep))]
    trial = Trial("refit", reference.free, start.prior, reference.values, state, reference.nuisance)
    return FitProblem(start.system, windows.take(keep)).fit_one(trial)


def _pushes(missing: Sequence[MissingTorque]) -> np.ndarray:
    """Return (W,) the largest fall of chi2 by a push in one slot of each window, over all joints."""
    return np.max([joint.score.max(1) for joint in missing], axis=0)


def _steps(missing: Sequence[MissingTorque]) -> np.ndarray:
    """Return (W,) the largest fall of chi2 by a step of a sensor's zero in each window, over all joints."""
    return np.max([joint.steps for joint in missing], axis=0)


def _apart(seen: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return (W,) whether the falls of held-out windows are far above those of fitted ones and of chance."""
    return found > max(MIN_FALL, MIN_RATIO * float(np.median(seen)))


def _few(windows: np.ndarray) -> np.ndarray:
    """Return which of these windows (W,) stand out; none where many do: then the reason lasts.

    The gain also needs some held-out windows.
    """
    many = windows.sum() > max(len(windows) // 3, 1)
    return np.zeros_like(windows) if many else windows


def _joined(a: Windows, b: Windows) -> Windows:
    def both(name: str) -> torch.Tensor | None:
        first, second = getattr(a, name), getattr(b, name)
        return None if first is None or second is None else torch.cat([first, second])

    return replace(
        a,
        doubt=both("doubt"),
        way=both("way"),
        wander=None if a.wander is None else joined(a.wander, b.wander or a.wander.none(b.value)),
        log=np.concatenate([a.log, b.log]),
        t0=np.concatenate([a.t0, b.t0]),
        t=torch.cat([a.t, b.t]),
        value=torch.cat([a.value, b.value]),
        valid=torch.cat([a.valid, b.valid]),
        state=torch.cat([a.state, b.state]),
        rests=np.concatenate([a.rests, b.rests]),
    )

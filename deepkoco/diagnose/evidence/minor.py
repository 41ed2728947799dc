"""Minor causes: significant, but no more than a healthy machine has, or hardly anything beside a first cause."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.causes.tolerance import BESIDE_HEALTHY, OF_MODEL_FILE, Healthy
from deepkoco.diagnose.data_sheet import guessed
from deepkoco.diagnose.evidence.priors import declared
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem

# Share of what all causes explain, below which a further cause describes the form of the first: a friction is never
# exactly Coulomb's, and a motion with little noise shows it. Second causes that were there explained 6 % and more.
LEAST_SHARE = 0.02
BEYOND = 1.1  # of the way from a learned value to null, up to which a log may show less than the healthy logs


class Minor(NamedTuple):
    """A cause that is significant and not named.

    Attributes:
        cause: The cause.
        fit: Fit with it.
        share: What it explains, over what all causes together explain; None if the amount of it is the reason.
        deflation: Factor on the covariance of the fit.
    """

    cause: Cause
    fit: Fit
    share: float | None
    deflation: float


def tolerated(problem: FitProblem, start: Baseline, cause: Cause, fit: Fit, deflation: float) -> bool:
    """Return whether a log shows no more of a cause than any healthy machine has.

    The 95 % interval of every size of the cause must lie within its tolerance about the baseline's value. Less of an
    effect than the healthy logs show is no fault either: what a simulation learned from them may only imitate a model
    error of their motions. So the interval may reach to null, and a tenth of what was learned beyond it. A cause
    without such a parameter is never tolerated.

    Args:
        problem: The windows.
        start: The baseline.
        cause: The cause.
        fit: Fit with it.
        deflation: Factor on the covariance of the fit.
    """
    if not cause.sizes or not set(cause.sizes) <= set(fit.free):
        return False
    rough = start.roughness
    if guessed(start):
        rough = max(rough, OF_MODEL_FILE if start.healthy is None else BESIDE_HEALTHY)
    loads = start.system.load_scales
    load = max(loads) if cause.joint is None else loads[cause.joint]
    period, speed = sample_period(problem.windows), usual_speed(start, cause, fit.state)
    nulls = {n: v for n, v in zip(problem.names, problem.null_values(), strict=False) if not np.isnan(v)}
    for parameter in declared(problem, cause.sizes):
        i = fit.free.index(parameter.name)
        reach = 1.96 * float(np.sqrt(max(fit.covariance[i, i], 0.0) * deflation))
        value, learned = fit.values[parameter.name], start.values[parameter.name]
        span = nulls.get(parameter.name, learned) - learned
        least, greatest = learned + min(BEYOND * span, 0.0), learned + max(BEYOND * span, 0.0)
        away = max(least - (value - reach), value + reach - greatest)
        most = cause.tolerance(Healthy(parameter, load, period, dict(fit.values), speed))
        if not away <= (most if is_changed(cause) else rough * most):
            return False
    return True


def usual_speed(start: Baseline, cause: Cause, state: Tensor) -> float:
    """Return the root mean square of the speed of a cause's joint [rad/s or m/s]; of the fastest joint if it has none.

    Args:
        start: The baseline.
        cause: The cause.
        state: (W, S) initial states of the windows.
    """
    speeds = state[:, start.system.joints : 2 * start.system.joints].square().mean(0).sqrt()
    return float(speeds.max() if cause.joint is None else speeds[cause.joint])


def sample_period(windows: Windows) -> float:
    """Return the time between two samples of the channel that is sampled fastest [s]."""
    return windows.length / max(float(windows.valid.sum(-1).max()), 1.0)

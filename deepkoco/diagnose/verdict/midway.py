"""Whether a unit became another one in the middle of its log: a payload that dropped, a screw that came loose.

No lasting cause explains such a log, and one set of parameters does not, either. Before and after the change each has
its own set.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline, refit
from deepkoco.diagnose.diagnosis import Evidence
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.pages.units import in_one_unit

FEWEST = 5  # windows before the change, and after it; of these, the one next to it is in neither fitted part
EXPLAINED = 10.0  # times by which the squared error falls where each part has its own parameters
CLEAR = 5.0  # standard deviations of what both parts tell of a parameter, from which it differs
SMALL = 0.2  # of the largest change, in standard deviations of the priors, below which one is not listed
MOST_LISTED = 3  # parameters that the sentence names


def changed_midway(start: Baseline, windows: Windows) -> Evidence | None:
    """Return a sentence if two parts of one log, each with its own parameters, are explained far better than the whole.

    The first and the last quarter of the windows are fitted alone. Where they would exchange, both sides are fitted
    again, without the two windows next to the exchange. A log that is explained a little better by two sets only has
    more parameters; therefore a tenfold fall. Where a part is not explained up to noise, something else than its
    parameters may be wrong, and the sentence says "may".

    Args:
        start: Prior and values of the parameters.
        windows: Fitted windows.

    Returns:
        The fall of the squared error and the sentence; None where nothing changed, for several logs, for few windows,
        and where a simulation diverges.
    """
    if len(set(windows.log.tolist())) != 1 or len(windows) < 2 * FEWEST:
        return None
    order = np.argsort(windows.t0)
    quarter = max(len(order) // 4, FEWEST)
    try:
        ends = [refit(start, windows.take(np.sort(some))) for some in (order[:quarter], order[-quarter:])]
        split = _exchange(start, windows, order, ends)
        if split is None:
            return None
        # The change may lie within either of the two windows at the exchange, and a blow there is no other unit.
        kept = (np.sort(order[: split - 1]), np.sort(order[split + 1 :]))
        parts = [windows.take(some) for some in kept]
        sides = [refit(start, part) for part in parts]
        whole = refit(start, windows.take(np.sort(np.concatenate(kept))))
    except DivergedError:
        return None
    fall = whole.chi2 / max(sum(side.chi2 for side in sides), 1e-300)
    if not fall > EXPLAINED:
        return None
    before, after = order[split - 1], order[split]
    first, last = float(windows.t0[before]), float(windows.t0[after]) + windows.length
    white = all(
        side.chi2 / part.samples <= start.most_noise(part) for side, part in zip(sides, parts, strict=True)
    )
    changed, reach = ("changed", "") if white else ("may have changed", ", though not down to the noise")
    text = (
        f"The unit {changed} in the middle of this log, between {first:.4g} and {last:.4g} s: with other parameters "
        f"before and after, the squared error falls by a factor of {fall:.3g}{reach}. "
        f"{clearest_changes(start, sides, parts)}"
        "Diagnose each part alone, the part before as a healthy log."
    )
    return Evidence("changed_midway", fall, EXPLAINED, text)


def _exchange(start: Baseline, windows: Windows, order: np.ndarray, ends: Sequence[Fit]) -> int | None:
    """Return the number of windows before the change: those that the parameters of the first quarter fit better."""
    problem = FitProblem(start.system, windows)
    costs = [problem.fit_states(end.values, windows.state)[1].numpy()[order] for end in ends]
    costs = [np.nan_to_num(cost, nan=np.inf, posinf=1e300) for cost in costs]
    totals = [costs[0][:k].sum() + costs[1][k:].sum() for k in range(FEWEST, len(order) - FEWEST + 1)]
    return FEWEST + int(np.argmin(totals)) if np.isfinite(totals).all() else None


def clearest_changes(start: Baseline, sides: Sequence[Fit], parts: Sequence[Windows]) -> str:
    """Return a sentence with the parameters that differ clearly, first those whose change their priors expect least.

    Args:
        start: Prior of the parameters.
        sides: Fits before and after.
        parts: Windows of each. What their residuals contain besides noise makes the parameters less certain.
    """
    first, last = sides
    deflations = [
        max(dispersion(side, part).deflation, start.least_deflation)
        for side, part in zip(sides, parts, strict=True)
    ]
    spread = np.sqrt(
        sum(side.covariance.diagonal() * factor for side, factor in zip(sides, deflations, strict=True))
    )
    away = {
        n: abs(last.values[n] - first.values[n]) / max(s, 1e-300)
        for n, s in zip(first.free, spread, strict=True)
    }
    sd = {n: start.system.parameter(n).prior_sd for n in away}
    moved = {n: abs(last.values[n] - first.values[n]) / sd[n] for n, z in away.items() if z > CLEAR}
    least = SMALL * max(moved.values(), default=0.0)
    far = sorted((n for n in moved if moved[n] >= least), key=lambda n: -moved[n])[:MOST_LISTED]
    if not far:
        return ""
    listed = []
    for name in far:
        (now, before), unit = in_one_unit(
            [last.values[name], first.values[name]], start.system.parameter(name).unit
        )
        listed.append(f"{name} from {before} to {now} {unit}".rstrip())
    return f"The clearest changes: {', '.join(listed)}. "

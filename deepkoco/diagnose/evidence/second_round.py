"""Whether fits of causes from the values as given can still change a ranking.

Such fits cost as much as all others. Slopes at the refit tell what each cause could gain beside it; what they do not
tell is that the refit was drawn away from its prior to imitate a cause, and that gains its penalty at most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import chi2

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.promising import MARGIN
from deepkoco.diagnose.evidence.ranking import penalty
from deepkoco.diagnose.evidence.screening import StartPoint
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.diagnose.residuals.whiteness import MAX_SD, more_than_noise
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit

LEADS = (
    0.9  # share of the largest promise at a joint from which an effect that takes long to simulate is fitted
)
CHANCE = 0.95  # share of units whose penalty is usual
ALIKE = 4.0  # times the squared error of a window, up to which another simulation explains it about as well


def can_gain(
    start: Baseline,
    windows: Windows,
    reference: Fit,
    best: Fit,
    causes: Sequence[Cause],
    promised: Mapping[str, float],
    wanted: float,
) -> bool:
    """Return whether any other cause could still be named, whatever it is fitted from.

    A fit that leaves only noise, and has left its prior no farther than any unit does, needs no rival: one that leaves
    it less far is not looked for. Where a refit leaves more than noise, slopes there are no bound.

    Args:
        start: The baseline.
        windows: The windows.
        reference: The refit.
        best: The best fit so far, with a cause or without.
        causes: Causes that compete.
        promised: Cause -> largest fall of the cost by slopes, or by a fit.
        wanted: Fall of the BIC from which a cause is named.
    """
    if start.healthy is None and more_than_noise(best, windows, start) is not None:
        return True
    # What the healthy unit leaves counts as noise, and its neighbouring residuals are alike.
    if best.chi2 > start.most_noise(windows, MAX_SD) * windows.samples:
        return True
    spread = dispersion(best, windows)
    deflation = max(spread.deflation, start.least_deflation)
    if best.converged and best.penalty <= usual_penalty(best) * deflation:
        return False
    if more_than_noise(reference, windows, start) is not None:
        return True
    samples, places = windows.samples / spread.correlation, SLOTS * len(windows)
    most = [
        (MARGIN * promised[c.name] + reference.penalty) / deflation - penalty(c, samples, places)
        for c in causes
        if c.name in promised
    ]
    return max(most, default=0.0) > wanted


def usual_penalty(fit: Fit) -> float:
    """Return the penalty that a fit of a unit like those of the prior exceeds by chance alone in one of twenty cases.

    Each parameter that the data tell adds the square of a standard normal number; one of which they tell a part, this
    part. Two causes whose costs differ by ``APART`` are not told apart, whatever is freed.
    """
    told = float(np.trace(fit.information @ fit.covariance)) if fit.free else 0.0
    return max(APART, float(chi2.ppf(CHANCE, max(told, 1.0))))


def explained_mostly(given: Fit, reference: Fit) -> bool:
    """Return whether the values as given leave about as much as the refit in half of the windows at least.

    A push explains some windows. Where the values as given do not explain the others, it is no start from there.

    Args:
        given: The simulation at the values as given.
        reference: The refit.
    """
    there, here = (fit.residual.square().flatten(1).sum(1) for fit in (given, reference))
    return bool((there <= ALIKE * here).double().mean() >= 0.5)


def promising_there(here: Sequence[StartPoint], there: Sequence[StartPoint]) -> list[StartPoint]:
    """Return starts of the causes that promise something at both points: the best at each, and all of a push.

    Args:
        here: Starts that promise most at the refit.
        there: Starts that promise most at the values as given, the best first.
    """
    names = {p.cause.name for p in there}
    found: dict[tuple[str, bool, int], StartPoint] = {}
    for at_refit, points in ((True, sorted(here, key=lambda p: -p.promise)), (False, there)):
        for k, p in enumerate(points):
            if p.cause.name in names and any(q.cause.name == p.cause.name for q in here):
                found.setdefault((p.cause.name, at_refit, k if p.cause.searched else 0), p)
    distinct: list[StartPoint] = []
    for p in found.values():
        if not any(q.cause.name == p.cause.name and q.values == p.values for q in distinct):
            distinct.append(p)
    return distinct


def without_hopeless_slow(
    points: Sequence[StartPoint], slow: set[str], charge: Mapping[str, float]
) -> list[StartPoint]:
    """Return starts without those of slow effects that another cause of their joint outdoes by its slopes.

    Args:
        points: Starts.
        slow: Effects that take a hundred times as long to simulate.
        charge: Cause -> fall of the cost that it needs for its parameters.
    """
    best: dict[int | None, float] = {}
    for p in points:
        worth = p.promise - charge[p.cause.name]
        best[p.cause.joint] = max(best.get(p.cause.joint, worth), worth)
    # A worth is negative where no cause of a joint is worth its parameters.
    least = {joint: worth - (1.0 - LEADS) * abs(worth) for joint, worth in best.items()}
    return [
        p
        for p in points
        if p.cause.effect not in slow or p.promise - charge[p.cause.name] >= least[p.cause.joint]
    ]

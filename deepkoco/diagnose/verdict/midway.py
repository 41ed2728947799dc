"""Whether a unit became another one in the middle of its log: a payload that dropped, a screw that came loose.

No lasting cause explains such a log, and one set of parameters does not, either. Before and after the change each has
its own set. The later one is that of the unit as it is now.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.changed_within import what_changed
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS
from deepkoco.diagnose.diagnosis import Evidence
from deepkoco.diagnose.gain import Gain, gain_of_fits
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.deflated import deflated
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.part import named_part
from deepkoco.pages.units import in_one_unit

FEWEST = 3  # windows before the change, and after it; of these, the one next to it is in neither fitted part
# The same where no held-out window confirms a part, and its error is more than so many noise variances: the parameters
# of a part can imitate an error that lasts in fewer windows, but not down to the noise.
FEWEST_ALONE, NEAR = 5, 5.0
EXPLAINED = 10.0  # times by which the squared error falls where each part has its own parameters
CLEAR = 5.0  # standard deviations of what both parts tell of a parameter, from which it differs
SMALL = 0.2  # of the largest change, in standard deviations of the priors, below which one is not listed
MOST_LISTED = 3  # parameters that the sentence names


@dataclass(frozen=True)
class ChangedMidway:
    """A change of the unit in the middle of its log.

    Attributes:
        after_s: Time until which the unit is certainly the former one [s].
        until_s: Time from which it is certainly the later one [s].
        fall: Times by which the squared error falls where each part has its own parameters.
        left: Squared error per sample that both parts leave, in noise variances.
        problem: Fit problem of the windows after the change.
        later: Fit of these windows.
        deflation: Deflation of its residuals.
        white: Whether both parts are explained down to the noise.
        changes: Sentence on the parameters that differ clearly; empty where none does.
    """

    after_s: float
    until_s: float
    fall: float
    left: float
    problem: FitProblem
    later: Fit
    deflation: float
    white: bool
    changes: str

    @property
    def when(self) -> str:
        """What happened and when, as a clause."""
        return what_changed(self.after_s, self.until_s, self.white)

    def evidence(self, log: str | Path | None) -> Evidence:
        """Return the change as a property of the residuals, and what to do next.

        Args:
            log: Path of the log; None for one that is in no file.
        """
        reach = "" if self.white else ", though not down to the noise"
        todo = "Diagnose the later part alone, with the part before as a healthy log"
        if len(self.problem.windows) < MIN_TRAINING_WINDOWS:
            todo = "Record more of the unit as it is now, and diagnose that with the part before as a healthy log"
        elif log is not None:
            later, former = named_part(log, self.until_s), named_part(log, stop=self.after_s)
            todo += f': deepkoco diagnose "{later}" --healthy "{former}", with the other options of this diagnosis'
        text = (
            f"T{self.when[1:]}: with other parameters before and after, the squared error falls by a factor of "
            f"{self.fall:.3g}{reach}. {self.changes}{todo}."
        )
        return Evidence("changed_midway", self.fall, EXPLAINED, text)

    def to_json(self) -> dict[str, Any]:
        """Return the change for `unexplained.changed_midway` of report.json."""
        return {"after_s": self.after_s, "until_s": self.until_s, "fall": self.fall, "text": self.when}


def changed_midway(start: Baseline, windows: Windows, held: Windows | None = None) -> ChangedMidway | None:
    """Return the change if two parts of one log, each with its own parameters, are explained far better than the whole.

    The first and the last quarter of the windows are fitted alone. Where they would exchange, both sides are fitted
    again, without the two windows next to the exchange. A log that is explained a little better by two sets only has
    more parameters; therefore a tenfold fall. Few windows with an error that lasts can be imitated by parameters of
    their own, so held-out windows of the parts must show the same fall. Where a part is not explained up to noise,
    something else than its parameters may be wrong, and the sentence says "may".

    Args:
        start: Prior and values of the parameters.
        windows: Fitted windows.
        held: Held-out windows of the same log; None where there are none.

    Returns:
        The change; None where nothing changed, for several logs, for few windows, and where a simulation diverges.
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
    left = sum(side.chi2 for side in sides) / sum(part.samples for part in parts)
    fall = whole.chi2 / max(sum(side.chi2 for side in sides), 1e-300)
    before, after = order[split - 1], order[split]
    first, last = float(windows.t0[before]), float(windows.t0[after]) + windows.length
    if not fall > EXPLAINED:
        return None
    predicted = _fall_on_held_out(start, held, (first, last), sides, whole)
    if predicted is None:
        if left > NEAR and min(split, len(order) - split) < FEWEST_ALONE:
            return None
    elif not predicted > EXPLAINED:
        return None
    white = all(
        side.chi2 / part.samples <= start.most_noise(part) for side, part in zip(sides, parts, strict=True)
    )
    problem = FitProblem(start.system, parts[1])
    deflations = [
        max(dispersion(side, part).deflation, start.least_deflation)
        for side, part in zip(sides, parts, strict=True)
    ]
    changes = clearest_changes(start, sides, deflations)
    later = problem.recentred(sides[1])
    return ChangedMidway(first, last, fall, left, problem, later, deflations[1], white, changes)


def gain_of_later_part(base: Refitted, changed: ChangedMidway, seed: int) -> Gain | None:
    """Measure the later unit as the extended simulation, on held-out windows after the change.

    Args:
        base: The baseline, refitted to the whole log. A log that is held out is one of the later unit.
        changed: The change.
        seed: Seed of the bootstrap.

    Returns:
        The gain; None without such windows, or where one of their simulations diverges.
    """
    held = base.held
    if held is not None and base.data.own:
        held = held.take(np.flatnonzero(held.t0 >= changed.until_s))
    if held is None or len(held) == 0:
        return None
    return gain_of_fits(changed.problem, base.start, held, base.reference, changed.later, seed)


def _fall_on_held_out(
    start: Baseline, held: Windows | None, between: tuple[float, float], sides: Sequence[Fit], whole: Fit
) -> float | None:
    """Return the fall of the squared error on the held-out windows of the parts; None without any."""
    if held is None:
        return None
    first, last = between
    alone = together = 0.0
    for side, mine in zip(sides, (held.t0 + held.length <= first, held.t0 >= last), strict=True):
        if mine.any():
            some = held.take(np.flatnonzero(mine))
            problem = FitProblem(start.system, some)
            own, other = (problem.fit_states(f.values, some.state)[1].sum().item() for f in (side, whole))
            alone, together = alone + own, together + other
    return together / alone if alone > 0.0 else None


def _exchange(start: Baseline, windows: Windows, order: np.ndarray, ends: Sequence[Fit]) -> int | None:
    """Return the number of windows before the change: those that the parameters of the first quarter fit better."""
    problem = FitProblem(start.system, windows)
    costs = [problem.fit_states(end.values, windows.state)[1].numpy()[order] for end in ends]
    costs = [np.nan_to_num(cost, nan=np.inf, posinf=1e300) for cost in costs]
    totals = [costs[0][:k].sum() + costs[1][k:].sum() for k in range(FEWEST, len(order) - FEWEST + 1)]
    return FEWEST + int(np.argmin(totals)) if np.isfinite(totals).all() else None


def clearest_changes(start: Baseline, sides: Sequence[Fit], deflations: Sequence[float]) -> str:
    """Return a sentence with the parameters that differ clearly, first those whose change their priors expect least.

    Args:
        start: Prior of the parameters.
        sides: Fits before and after.
        deflations: Of the residuals of each. What they contain besides noise makes the parameters less certain.
    """
    first, last = sides
    spread = np.sqrt(
        sum(
            deflated(side, factor, start.narrowed).diagonal()
            for side, factor in zip(sides, deflations, strict=True)
        )
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

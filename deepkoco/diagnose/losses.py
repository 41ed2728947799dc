"""Lost commands among the causes: whether they are named, and what a report says of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.classes import APART
from deepkoco.diagnose.diagnosis import Estimate, Evidence, Finding
from deepkoco.diagnose.lost import LostCommands, lost_commands
from deepkoco.diagnose.pushed import touched
from deepkoco.diagnose.residuals import SLOTS, dispersion
from deepkoco.diagnose.selection import Ranking, penalty
from deepkoco.identify.fit import Fit, FitProblem
from deepkoco.identify.prior import Prior

FEWEST = 3  # losses that show clearly: one or two may as well be a push, and model error bends to those that do not


class Losses(NamedTuple):
    """Lost commands that are named.

    Attributes:
        finding: What a report shows.
        problem: The windows with the commands that acted.
        fit: The model on them.
    """

    finding: Finding
    problem: FitProblem
    fit: Fit


def best_losses(
    problem: FitProblem,
    fit: Fit,
    prior: Prior,
    causes: Sequence[Cause],
    ranking: Ranking,
    floor: float,
    wanted: float,
) -> Losses | None:
    """Lost commands, where they explain clearly more than the best candidate of a ranking.

    Args:
        problem, fit, prior: Model to be improved.
        causes: Lost commands at every command of the system.
        ranking: Candidates on top of the same fit.
        floor: chi2 per sample of a healthy unit.
        wanted: Fall of the BIC that they must reach.
    """
    tried = [(cause, lost_commands(problem, fit, prior, cause.index)) for cause in causes]
    found = [(lost.total, cause, lost) for cause, lost in tried if lost is not None and lost.lost >= FEWEST]
    if not found:
        return None
    _, cause, lost = min(found, key=lambda item: item[0])
    rival = ranking.best if ranking.candidates else None
    lowest = lost.fit if rival is None or lost.fit.cost < rival.fit.cost else rival.fit
    spread = dispersion(lowest, problem.windows)
    deflation = max(spread.deflation, floor)
    ratio = fit.cost - lost.fit.cost
    score = ratio / deflation - lost.charge
    least = wanted
    if rival is not None:
        charge = penalty(
            rival.cause, problem.windows.samples / spread.correlation, SLOTS * len(problem.windows)
        )
        # A delay of one tick loses every command for a tick: what takes one number to say goes first.
        least = max(wanted, rival.likelihood_ratio / deflation - charge + APART)
        if rival.cause.effect == "event":
            # A push can mend any one window; losses that show in the others go first.
            others = ~touched(problem.windows, rival.fit.values)
            fell = ((fit.residual**2).sum((1, 2)) - (lost.fit.residual**2).sum((1, 2))).numpy()
            least = wanted if fell[others].sum() / deflation - lost.charge > wanted else least
    if score <= least:
        return None
    needed = (lost.charge + wanted) * deflation
    return Losses(_finding(lost, cause, ratio, score, needed), lost.problem, lost.fit)


def _finding(lost: LostCommands, cause: Cause, ratio: float, score: float, needed: float) -> Finding:
    """As a report shows it: fall of the cost, fall of the BIC, and the fall of the cost that would have sufficed."""
    # scipy.stats takes a third of a second to load, and few units lose commands.
    from scipy.stats import binomtest

    interval = binomtest(lost.lost, max(lost.ticks, 1)).proportion_ci(method="wilson")
    text = (
        f"{lost.lost} of {lost.ticks} commands whose loss would show clearly were held over by the one before. "
        f"Simulating {lost.found} of them as lost lowers the squared error by {ratio:,.0f} noise variances; chance and "
        f"saying which ones they are explain up to {needed:,.0f}. Which ones is known to a few ticks."
    )
    evidence = Evidence("likelihood_ratio", ratio, needed, text)
    own = {f"{cause.effect}.share": Estimate(lost.share, float(interval.low), float(interval.high), "1")}
    return Finding(cause.name, cause.family, (cause.name,), score, 1.0, own, (evidence,))

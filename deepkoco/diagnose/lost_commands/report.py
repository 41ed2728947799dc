"""Lost commands among the causes: whether they are named, and what a report says of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.diagnosis import Estimate, Evidence, Finding
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.elimination import without
from deepkoco.diagnose.evidence.event_windows import touched
from deepkoco.diagnose.evidence.selection import PATIENCE, penalty, prior_with
from deepkoco.diagnose.lost_commands.search import LostCommands, lost_commands
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion, missing_torque
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.prior import Prior

# One or two losses may as well be a push, and model error bends to losses that do not show clearly.
MIN_CLEAR_LOSSES = 3
CHANCE = 1e-3  # probability under independence, below which losses depend on the motion


class Losses(NamedTuple):
    """Lost commands that are worth their description.

    Attributes:
        finding: What a report shows.
        problem: The windows with the commands that acted.
        fit: The model on them.
        charge: What the BIC charges for them.
    """

    finding: Finding
    problem: FitProblem
    fit: Fit
    charge: float


def best_losses(
    problem: FitProblem, fit: Fit, prior: Prior, causes: Sequence[Cause], floor: float, wanted: float
) -> Losses | None:
    """Lost commands, where they pay.

    Args:
        problem, fit, prior: Model to be improved.
        causes: Lost commands at every command of the system.
        floor: Least factor by which likelihood ratios are too large on a healthy unit.
        wanted: Fall of the BIC that they must reach.
    """
    tried = [(cause, lost_commands(problem, fit, prior, cause.index)) for cause in causes]
    found = [
        (lost.total, cause, lost)
        for cause, lost in tried
        if lost is not None and lost.lost >= MIN_CLEAR_LOSSES and _by_chance(lost)
    ]
    if not found:
        return None
    _, cause, lost = min(found, key=lambda item: item[0])
    deflation = max(dispersion(lost.fit, problem.windows).deflation, floor)
    ratio = fit.cost - lost.fit.cost
    score = ratio / deflation - lost.charge
    if score <= wanted:
        return None
    needed = (lost.charge + wanted) * deflation
    return Losses(_finding(lost, cause, ratio, score, needed), lost.problem, lost.fit, lost.charge)


def instead_of_push(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    push: Cause,
    fit: Fit,
    causes: Sequence[Cause],
) -> tuple[str, ...]:
    """Names of lost commands, too few to be named by themselves, that say as much as a push, or more.

    A command that is held over while it should have changed acts as a push does, of a size and a time that are known.
    At least one has to be lost where the push is.

    Args:
        problem: Windows.
        start: The baseline.
        accepted: Causes that were selected.
        push: The push among them.
        fit: Model with all of them.
        causes: Lost commands at every command of the system.
    """
    less = problem.fit_one(without(problem, start, accepted, push, fit), PATIENCE)
    prior = prior_with(problem, start, [c for c in accepted if c is not push], less.values)
    spread = dispersion(fit, problem.windows)
    deflation = max(spread.deflation, start.least_deflation)
    samples, places = problem.windows.samples / spread.correlation, SLOTS * len(problem.windows)
    pushed = touched(problem.windows, fit.values)
    names = []
    for cause in causes:
        lost = lost_commands(problem, less, prior, cause.index)
        if lost is None or lost.lost >= MIN_CLEAR_LOSSES or not _by_chance(lost) or not _inside(lost, pushed):
            continue
        behind = (lost.fit.cost - fit.cost) / deflation + lost.charge - penalty(push, samples, places)
        if behind < APART:
            names.append(cause.name)
    return tuple(names)


def _inside(lost: LostCommands, pushed: np.ndarray) -> bool:
    """Whether a command was lost during the windows (W,) that a push touches."""
    windows = lost.problem.windows
    for w in np.flatnonzero(pushed):
        log, begin = windows.log[w], windows.t0[w]
        t = windows.commands[log].t[lost.logs[log].lost]
        if ((t >= begin) & (t < begin + windows.length)).any():
            return True
    return False


def _by_chance(lost: LostCommands) -> bool:
    """Whether which commands were lost has nothing to do with the motion, as the loss of a message has not.

    What else is missing from a model wants offsets of a certain sign or size where the joint is, and as it moves.
    """
    # scipy.stats takes a third of a second to load, and few units lose commands.
    from scipy.stats import mannwhitneyu

    problem = lost.problem
    motion = missing_torque(problem, lost.fit)[problem.system.command_joints[lost.index]]
    gone, seen = [], []
    for number, (log, command) in enumerate(zip(lost.logs, problem.windows.commands, strict=True)):
        shown = log.lost | (log.worth > lost.price)
        own = motion.log == number
        if not own.any():
            continue  # it never moved
        order = np.argsort(motion.time[own], axis=None)
        t = command.t[shown]
        angle, speed = (
            np.interp(t, motion.time[own].ravel()[order], x[own].ravel()[order])
            for x in (motion.theta, motion.omega)
        )
        sent = lost.sent[number]
        way = np.sign(np.diff(sent, prepend=sent[0])[shown])
        middle = np.median(motion.theta[own])
        gone.append(log.lost[shown])
        seen.append(np.stack([way * (angle - middle), way * speed, np.abs(speed)]))
    which, all_seen = np.concatenate(gone), np.concatenate(seen, axis=1)
    if which.all():
        return True
    return all(mannwhitneyu(x[which], x[~which]).pvalue > CHANCE for x in all_seen)


def _finding(lost: LostCommands, cause: Cause, ratio: float, score: float, needed: float) -> Finding:
    """As a report shows it: fall of the cost, fall of the BIC, and the fall of the cost that would have sufficed."""
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

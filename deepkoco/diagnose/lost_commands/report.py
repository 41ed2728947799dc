"""Lost commands as a cause: the conditions for naming them, and their finding in the report."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.diagnosis import Estimate, Evidence, Finding
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.elimination import without
from deepkoco.diagnose.evidence.event_windows import touched
from deepkoco.diagnose.evidence.how_probable import alone, listed
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import penalty
from deepkoco.diagnose.evidence.selection import PATIENCE
from deepkoco.diagnose.lost_commands.search import LostCommands, lost_commands
from deepkoco.diagnose.residuals.residuals import SLOTS, Dispersion, dispersion, missing_torque
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.prior import Prior

# One or two losses could also be a push, and model error can imitate losses that do not show clearly.
MIN_CLEAR_LOSSES = 3
CHANCE = 1e-3  # probability under independence, below which losses depend on the motion


class Losses(NamedTuple):
    """Accepted lost commands.

    Attributes:
        finding: Finding of the report.
        problem: Windows with the commands that acted.
        fit: Fit of the model on these windows.
        charge: Charge of the BIC for the lost commands.
    """

    finding: Finding
    problem: FitProblem
    fit: Fit
    charge: float


def best_losses(
    problem: FitProblem,
    fit: Fit,
    prior: Prior,
    causes: Sequence[Cause],
    floor: float,
    wanted: float,
    losing: Container[int] = (),
) -> tuple[Losses | None, Fit]:
    """Return the lost commands of the channel with the lowest cost, and the best fit of the model without them.

    Stick and slip leave a fit many minima, and a search that changes the commands may lead a fit from one to another.
    What that gains is no work of the losses. So the model without them is also fitted from where the fit with them
    ended, and they have to lower the BIC beside the better one of its fits.

    Args:
        problem, fit, prior: Model whose residuals are to be explained.
        causes: Lost commands of every command channel of the system.
        floor: Smallest deflation.
        wanted: Fall of the BIC that they need.
        losing: Indices of the commands of which healthy logs of the unit also lose some; asked of what would be named.

    Returns:
        The losses, None where they do not lower the BIC enough; and ``fit``, or a better one.
    """
    tried = [(cause, lost_commands(problem, fit, prior, cause.index)) for cause in causes]
    found = [
        (lost.total, cause, lost)
        for cause, lost in tried
        if lost is not None and lost.lost >= MIN_CLEAR_LOSSES and _by_chance(lost)
    ]
    for _, cause, lost in sorted(found, key=lambda item: item[0]):
        deflation = max(
            deflation_with(lost.found, dispersion(lost.fit, problem.windows), problem.windows.samples), floor
        )
        needed = (lost.charge + wanted) * deflation
        if fit.cost - lost.fit.cost <= needed:
            return None, fit
        plain = _from_where_losses_led(problem, fit, prior, lost)
        ratio = plain.cost - lost.fit.cost
        if ratio <= needed:
            return None, plain
        if cause.index not in losing:
            finding = _finding(lost, cause, ratio, ratio / deflation - lost.charge, needed, wanted)
            return Losses(finding, lost.problem, lost.fit, lost.charge), plain
    return None, fit


def _from_where_losses_led(problem: FitProblem, fit: Fit, prior: Prior, lost: LostCommands) -> Fit:
    """Return the model without losses, fitted from where the fit with them ended; ``fit`` if that is no better."""
    there = Trial(fit.name, fit.free, prior, lost.fit.values, lost.fit.state, lost.fit.nuisance)
    again = problem.fit([there], PATIENCE)[0]
    return again if not again.diverged and again.cost < fit.cost else fit


def deflation_with(positions: int, spread: Dispersion, samples: float) -> float:
    """Return the deflation of a fit in which so many ticks were chosen freely; infinite where nothing else is left.

    Each chosen position uses up one independent sample, as a fitted parameter does. So chi2 is divided by the
    independent samples that remain. Without this, a pattern of losses fits a log of few independent samples, and the
    small residuals that it leaves speak for it.

    Args:
        positions: Number of ticks that were counted as lost.
        spread: Dispersion of the residuals of the fit.
        samples: Number of samples.
    """
    independent = samples / spread.correlation
    if independent <= positions:
        return math.inf
    return max(1.0, spread.chi2_per_sample * independent / (independent - positions)) * spread.correlation


def instead_of_push(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    push: Cause,
    fit: Fit,
    causes: Sequence[Cause],
) -> tuple[str, ...]:
    """Return lost commands, too few to be named alone, that explain the data as well as a push.

    A lost command acts like a push of known size and time: the actuator holds the previous command although the
    command should have changed. At least one command must be lost in a window that the push touches.

    Args:
        problem: Windows.
        start: The baseline.
        accepted: Accepted causes.
        push: The push among them.
        fit: Model with all of them.
        causes: Lost commands of every command channel of the system.

    Returns:
        Names of these causes.
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
        if behind < APART and not (start.losing is not None and cause.index in start.losing):
            names.append(cause.name)
    return tuple(names)


def _inside(lost: LostCommands, pushed: np.ndarray) -> bool:
    """Return whether a command was lost in one of the windows (W,) that a push touches."""
    windows = lost.problem.windows
    for w in np.flatnonzero(pushed):
        log, begin = windows.log[w], windows.t0[w]
        t = windows.commands[log].t[lost.logs[log].lost]
        if ((t >= begin) & (t < begin + windows.length)).any():
            return True
    return False


def _by_chance(lost: LostCommands) -> bool:
    """Return whether the lost commands are independent of the joint's angle and speed (rank-sum tests).

    A message is lost independently of the motion. If another mechanism is missing from the model, the fitted losses
    depend on angle or speed.
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
            continue  # the joint never moved in this log
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


def _finding(
    lost: LostCommands, cause: Cause, ratio: float, score: float, needed: float, wanted: float
) -> Finding:
    """Return the finding of the report.

    Args:
        lost: The lost commands.
        cause: Their cause.
        ratio: Fall of the cost.
        score: Fall of the BIC.
        needed: Fall of the cost that would have sufficed.
        wanted: Fall of the BIC that is asked for.
    """
    from scipy.stats import binomtest

    interval = binomtest(lost.lost, max(lost.ticks, 1)).proportion_ci(method="wilson")
    text = (
        f"The loss of {lost.ticks} commands would show clearly; {lost.lost} of them were lost and replaced by the "
        f"previous command. With {lost.found} lost commands, the squared error of the simulation falls by {ratio:,.0f} "
        f"noise variances. Chance and the choice of their positions explain a fall of up to {needed:,.0f}. The "
        "positions are known to a few ticks."
    )
    evidence = Evidence("likelihood_ratio", ratio, needed, text)
    own = {f"{cause.effect}.share": Estimate(lost.share, float(interval.low), float(interval.high), "1")}
    chances = alone(cause.name, score, wanted)
    return Finding(
        cause.name,
        cause.family,
        (cause.name,),
        score,
        chances[cause.name],
        own,
        (evidence,),
        probabilities=listed(chances),
    )

"""Search for lost commands: sent and logged commands that never acted, so that the actuator held the previous one.

Every window is searched separately. The effect of the loss of each single tick on the measurements is simulated once.
The effect of a pattern of losses is the sum of such responses with known sizes. The charge for a pattern is the length
of its description. On a slow machine, losses of neighbouring ticks have nearly the same effect, so the number of
losses is found better than their positions.

Source: detection of a sequence (:mod:`deepkoco.diagnose.lost_commands.sequence`) under the two-part code of minimum
    description length (Rissanen 1978).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.diagnose.lost_commands.sequence import Responses, held_over, innovations, offset_of, pattern
from deepkoco.diagnose.residuals.residuals import acting_system, push_of
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.simulate.simulator import predict
from deepkoco.fit.solve.prior import Prior

BEFORE = 0.15  # time before a window, as a share of its length, whose commands still act in it (lags, delays)
MIN_REGULAR = 0.9  # share of regular ticks below which the duration of a lost tick is not defined
PACE = 1.5  # factor from the median interval within which a tick is regular
SMALL = 1e-3  # simulated offset where a command does not change, as a share of the largest command
LANES = 2000  # windows in one batch of simulations
MOST_TICKS = 400  # commands in a window above which the search would take too long
MOST_LOST = 0.5  # share of lost commands above which the reason is not a loss but a delay
FIRST_SHARE = 0.1  # share of lost commands that the first round expects
MIN_SHARE, MAX_SHARE = 0.01, 0.3  # range of the share that later rounds expect
# Share of the best tick's fall of chi2 that other ticks need in the first round; its powers in the next rounds.
MIN_OF_BEST_TICK = 0.2
ROUNDS = 8  # largest number of rounds of search and fit
CLEAR = (
    4.0  # fall of chi2 by the loss of a tick, in prices of a tick, from which the tick counts for the share
)
MIN_CLEAR_TICKS = 10  # number of clear ticks from which the share is computed from them alone


class Shown(NamedTuple):
    """Ticks of one log.

    Attributes:
        lost: (n,) whether each tick was lost.
        worth: (n,) fall of chi2 by the loss of each tick, had it been lost.
    """

    lost: np.ndarray
    worth: np.ndarray


@dataclass(frozen=True)
class LostCommands:
    """Result of the search in one command channel.

    Attributes:
        index: Index of the command channel.
        logs: Ticks of every log.
        problem: Windows with the commands that acted instead of those that were sent.
        fit: Fit of the same model to these windows.
        lost: Number of lost ticks among those whose loss would show clearly.
        ticks: Number of ticks whose loss would show clearly.
        searched: Number of ticks that could have been counted as lost.
        found: Number of ticks that were counted as lost.
        price: Fall of the cost that a lost tick needed.
        sent: Sent commands of every log.
    """

    index: int
    logs: tuple[Shown, ...]
    problem: FitProblem
    fit: Fit
    lost: int
    ticks: int
    searched: int
    found: int
    price: float
    sent: tuple[np.ndarray, ...] = ()

    @property
    def share(self) -> float:
        """Share of the commands that were lost."""
        return self.lost / max(self.ticks, 1)

    @property
    def charge(self) -> float:
        """Charge of the BIC: twice the logarithm of the number of patterns, and the share as one parameter."""
        n, k = self.searched, self.found
        patterns = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
        return 2.0 * patterns + math.log(max(self.problem.windows.samples, 2))

    @property
    def total(self) -> float:
        """Cost of the fit plus the charge for the pattern."""
        return self.fit.cost + self.charge


def why_not_searched(windows: Windows, losing: Sequence[int] = ()) -> str | None:
    """Return why lost commands are not searched for, in all or some command channels; None if all are searched.

    Args:
        windows: Windows to explain.
        losing: Indices of the commands of which healthy logs of the unit also lose some.
    """
    for log in np.unique(windows.log):
        t = windows.commands[log].t
        gap = np.diff(t)
        usual = float(np.median(gap)) if len(gap) else 0.0
        regular = (gap < PACE * usual) & (gap > usual / PACE)
        if len(t) < 20 or np.mean(regular) < MIN_REGULAR:
            return "commands do not come at a regular rate, so the duration of a lost one is not defined"
    most = max(len(own) for own in _spans(windows))
    if most > MOST_TICKS:
        return f"a window contains {most} commands; the search takes at most {MOST_TICKS}"
    if losing:
        which = " and ".join(str(k + 1) for k in losing)
        return f"command {which} is not searched: the healthy logs also lose some of its commands"
    return None


def lost_commands(problem: FitProblem, fit: Fit, prior: Prior, index: int) -> LostCommands | None:
    """Search the ticks of one command for lost ones, and refit the model to the commands that acted.

    The search is linearised around a fit, and the losses bias this fit. Search and fit therefore alternate, with
    the clearest losses first.

    Args:
        problem: Windows with the sent commands.
        fit: Model whose residuals are to be explained.
        prior: Its prior.
        index: Index of the command channel.

    Returns:
        The lost commands; None if there are none or if there is no search (:func:`why_not_searched`). Also None if
        more than half of the commands would be lost, or if offsets of the opposite sign explain more.
    """
    windows = problem.windows
    sent = [c.column(index) for c in windows.commands]
    if all(np.ptp(u) == 0.0 for u in sent) or why_not_searched(windows) is not None:
        return None
    spans = _spans(windows)
    patterns = [np.zeros(len(u), dtype=bool) for u in sent]
    share, acted, now = FIRST_SHARE, problem, fit
    best: LostCommands | None = None
    for turn in range(ROUNDS):
        before = patterns
        part = MIN_OF_BEST_TICK ** (turn + 1)
        logs, price, last = _search(acted, now, index, spans, sent, before, share, part)
        patterns = [shown.lost for shown in logs]
        if not any(p.any() for p in patterns):
            return None
        acted = FitProblem(problem.system, _acting(windows, index, patterns))
        now = acted.fit_one(Trial(fit.name, fit.free, prior, now.values, now.state, now.nuisance))
        found = _counted(index, logs, acted, now, price, sent)
        best = found if best is None or found.total < best.total else best
        share = float(np.clip(found.share, MIN_SHARE, MAX_SHARE))
        if last and all((a == b).all() for a, b in zip(patterns, before, strict=True)):
            break
    if best is None or best.share > MOST_LOST or _imitated(best, index, spans, sent):
        return None
    return best


def _imitated(
    found: LostCommands, index: int, spans: Sequence[np.ndarray], sent: Sequence[np.ndarray]
) -> bool:
    """Return whether offsets of the opposite sign, which no loss can cause, would explain more.

    Offsets at hundreds of ticks explain part of any irregular residual, with either sign. Real losses have one sign.
    """
    windows, real, opposite = found.problem.windows, 0.0, 0.0
    responses = _responses(found.problem, found.fit, index, spans, sent)
    for response, own, log in zip(responses, spans, windows.log, strict=True):
        given = sent[log][own[0] - 1 : own[-1] + 1]
        lost = found.logs[log].lost[own]
        # Residuals if nothing was lost.
        without = response.residual + response.change @ offset_of(given, lost)
        turned = response._replace(residual=-without)
        other = pattern(turned, given, np.zeros_like(lost), found.price, found.price)
        plain = without @ without
        real += plain - response.residual @ response.residual
        opposite += plain - ((without + response.change @ offset_of(given, other)) ** 2).sum()
    return bool(opposite > real)


def _counted(
    index: int,
    logs: Sequence[Shown],
    problem: FitProblem,
    fit: Fit,
    price: float,
    sent: Sequence[np.ndarray],
) -> LostCommands:
    lost = np.concatenate([shown.lost for shown in logs])
    worth = np.concatenate([shown.worth for shown in logs])
    searched = lost | (worth > price)
    # Half of the losses whose fall of chi2 is hardly above the price are missed, so only clear ticks are counted.
    clear = worth > CLEAR * price
    clear = clear if clear.sum() >= MIN_CLEAR_TICKS else searched
    counts = int((lost & clear).sum()), int(clear.sum()), int(searched.sum()), int(lost.sum())
    return LostCommands(index, tuple(logs), problem, fit, *counts, price, tuple(sent))


def _spans(windows: Windows) -> list[np.ndarray]:
    """Return for each window the ticks that may act in it."""
    spans = []
    for w, log in enumerate(windows.log):
        t = windows.commands[log].t
        first = int(np.searchsorted(t, windows.t0[w] - BEFORE * windows.length, side="right")) - 1
        last = int(np.searchsorted(t, windows.t0[w] + windows.length))
        # The first command of a log has no previous command that could be held.
        spans.append(np.arange(max(first, 1), max(last, 2)))
    return spans


def _acting(windows: Windows, index: int, patterns: Sequence[np.ndarray]) -> Windows:
    """Return the windows with the commands that acted."""
    commands = []
    for command, lost in zip(windows.commands, patterns, strict=True):
        value = np.array(command.value, dtype=float)
        column = value if value.ndim == 1 else value[:, index]
        column[:] = held_over(column.copy(), np.flatnonzero(lost))
        commands.append(CommandSeries(command.t, value))
    return replace(windows, commands=tuple(commands))


def _search(
    problem: FitProblem,
    fit: Fit,
    index: int,
    spans: Sequence[np.ndarray],
    sent: Sequence[np.ndarray],
    before: Sequence[np.ndarray],
    share: float,
    part: float,
) -> tuple[list[Shown], float, bool]:
    """Search all windows once.

    Args:
        problem, fit: Model under the previous pattern.
        index: Index of the command channel.
        spans: Ticks of each window.
        sent: Commands of each log.
        before: Previous pattern of each log.
        share: Expected share of lost ticks.
        part: Share of the best tick's fall of chi2 that a tick needs.

    Returns:
        The ticks of every log, the price of a tick, and whether the price alone limited the search.
    """
    windows = problem.windows
    price = max(2.0 * math.log((1.0 - share) / share), 0.0)
    responses = list(_responses(problem, fit, index, spans, sent))
    most = 0.0
    for response, own, log in zip(responses, spans, windows.log, strict=True):
        step = sent[log][own - 1] - sent[log][own]
        worth = 2.0 * step * (response.residual @ response.change) - step**2 * response.size
        most = max(most, float(worth.max(initial=0.0)))
    bar = max(price, part * most)
    # In overlapping windows, a tick is lost if it is lost in one of them.
    logs = [Shown(np.zeros_like(p), np.zeros(len(p))) for p in before]
    for response, own, log in zip(responses, spans, windows.log, strict=True):
        given = sent[log][own[0] - 1 : own[-1] + 1]
        logs[log].lost[own] |= pattern(response, given, before[log][own], bar, price)
        worth = np.diff(given) ** 2 * response.size
        logs[log].worth[own] = np.maximum(logs[log].worth[own], worth)
    return logs, price, bar == price


def _responses(
    problem: FitProblem, fit: Fit, index: int, spans: Sequence[np.ndarray], sent: Sequence[np.ndarray]
) -> Iterator[Responses]:
    """Yield for each window the responses of its measurements to an offset of the command in each of its ticks."""
    problem, fit = problem.as_fitted(fit)
    windows, states = problem.windows, fit.state.shape[1]
    system = acting_system(problem, fit)
    theta = np.array([fit.values[n] for n in problem.names])
    named = {
        n: torch.tensor(fit.values[n], dtype=torch.float64) for n in problem.names if n not in Push.NAMES
    }
    push = push_of(problem, theta)  # (J, 1, W, n)
    tiny = 1e-6
    initial = fit.state[None].repeat(1 + states, 1, 1)
    for s in range(states):
        initial[1 + s, :, s] += tiny
    at = predict(system, windows, named, initial, push)
    slopes = ((at[1:] - at[0]) * problem.weight).flatten(2).permute(1, 2, 0)  # (W, samples, states)
    ring = max(len(own) for own in spans)
    commands, sizes = _ring(windows, index, ring, sent)
    block = max(LANES // ring, 1)
    for begin in range(0, len(windows), block):
        picked = list(range(begin, min(begin + block, len(windows))))
        rows = np.repeat(picked, [len(spans[w]) for w in picked])
        ticks = np.concatenate([spans[w] for w in picked])
        many = windows.take(rows)
        many = replace(
            many,
            commands=commands,
            log=many.log * ring + ticks % ring,
            known=tuple(k for k in windows.known for _ in range(ring)),
        )
        row = torch.from_numpy(rows)
        wide = None if push is None else push[:, :, row]
        moved = predict(system, many, named, fit.state[row][None], wide)[0]
        size = torch.from_numpy(np.concatenate([sizes[windows.log[w]][spans[w]] for w in picked]))
        change = ((moved - at[0][row]) * problem.weight[row]).flatten(1) / size[:, None]
        for w, response in zip(picked, change.split([len(spans[w]) for w in picked]), strict=True):
            is_there = windows.valid[w].flatten().numpy()
            ticks = windows.commands[windows.log[w]].t[spans[w]] - windows.t0[w]
            yield innovations(
                slopes[w].numpy()[is_there],
                response.mT.numpy()[is_there],
                fit.residual[w].flatten().numpy()[is_there],
                windows.t[w].flatten().numpy()[is_there],
                ticks,
            )


def _ring(
    windows: Windows, index: int, ring: int, sent: Sequence[np.ndarray]
) -> tuple[tuple[CommandSeries, ...], list[np.ndarray]]:
    """Return the commands with an offset in every ``ring``-th tick, for each log and each first tick, and the offsets.

    A window has at most ``ring`` ticks, so it contains at most one offset. The offset equals that of a loss of the
    tick, because the response to a command need not be linear.
    """
    commands, sizes = [], []
    for number, command in enumerate(windows.commands):
        acted = np.array(command.column(index), dtype=float)
        offset = np.append(0.0, acted[:-1] - sent[number][1:])
        least = SMALL * max(float(np.abs(sent[number]).max(initial=0.0)), 1e-12)
        # A tick whose loss alone changes nothing can matter together with other losses.
        offset = np.where(np.abs(offset) < least, least, offset)
        place = np.arange(len(acted)) % ring
        for k in range(ring):
            value = np.array(command.value, dtype=float)
            column = value if value.ndim == 1 else value[:, index]
            column[place == k] += offset[place == k]
            commands.append(CommandSeries(command.t, value))
        sizes.append(offset)
    return tuple(commands), sizes

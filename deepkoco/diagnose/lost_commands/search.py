"""Commands that were sent and logged but never acted: the actuator held the one before for a tick.

Which ticks were lost is searched for in every window by itself. What the loss of each single tick does to the
measurements is simulated once; a pattern of losses is a sum of such responses with known sizes, and the errors have to
pay for saying which ticks they are. Neighbouring ticks do nearly the same to a slow machine: how many were lost is
found better than which.

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

BEFORE = 0.15  # share of a window before it whose commands still act in it, through lags and delays
REGULAR = 0.9  # share of the ticks that come at the usual pace, without which a lost one has no length
PACE = 1.5  # factor from the usual pace within which a tick is regular
SMALL = 1e-3  # offset that is simulated where a command does not change, in largest commands
LANES = 2000  # windows simulated at once
MOST_TICKS = 400  # in a window: beyond that the search takes too long
MOST_LOST = 0.5  # share of the commands from which on it is no loss but a delay
SHARE = 0.1  # share of lost commands that the first turn expects
RARE, COMMON = 0.01, 0.3  # shares that a later one may expect
# Share of the best tick's worth that others must have in the first turn; its powers in the next ones.
FIRST = 0.2
TURNS = 8  # of search and fit, at most
CLEAR = 4.0  # prices of a tick that its loss must be worth to count for the share
MIN_CLEAR_TICKS = 10  # ticks that the share is taken from, where there are as many


class Shown(NamedTuple):
    """Ticks of one log.

    Attributes:
        lost: (n,) whether each tick was lost.
        worth: (n,) fall of chi2 that its loss would be worth, had it been lost.
    """

    lost: np.ndarray
    worth: np.ndarray


@dataclass(frozen=True)
class LostCommands:
    """What was found.

    Attributes:
        index: Which command.
        logs: The ticks of every log.
        problem: The windows, with the commands that acted in the place of those that were sent.
        fit: Fit of the same model to them.
        lost: Ticks that were lost, of those whose loss would show clearly.
        ticks: Ticks whose loss would show clearly.
        searched: Ticks that were or could have been taken for lost.
        found: Those that were.
        price: Fall of the cost that a lost tick had to be worth.
        sent: Commands of every log, all that were sent.
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
        """What the BIC charges: twice the logarithm of the number of patterns, and the share as a parameter."""
        n, k = self.searched, self.found
        patterns = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
        return 2.0 * patterns + math.log(max(self.problem.windows.samples, 2))

    @property
    def total(self) -> float:
        """Cost of the fit and of writing the pattern down."""
        return self.fit.cost + self.charge


def why_not_searched(windows: Windows, losing: Sequence[int] = ()) -> str | None:
    """Why lost commands, or those of some command, are not searched for in these windows; None where all are.

    Args:
        windows: Windows to explain.
        losing: Commands of which healthy logs of the unit lose some, too.
    """
    for log in np.unique(windows.log):
        t = windows.commands[log].t
        gap = np.diff(t)
        usual = float(np.median(gap)) if len(gap) else 0.0
        regular = (gap < PACE * usual) & (gap > usual / PACE)
        if len(t) < 20 or np.mean(regular) < REGULAR:
            return "commands do not come at a regular pace, and a lost one has no length"
    most = max(len(own) for own in _spans(windows))
    if most > MOST_TICKS:
        return f"a window holds {most} commands, more than the {MOST_TICKS} for which the search is made"
    if losing:
        which = " and ".join(str(k + 1) for k in losing)
        return f"not for command {which}: the healthy logs lose some of it, too"
    return None


def lost_commands(problem: FitProblem, fit: Fit, prior: Prior, index: int) -> LostCommands | None:
    """Search the ticks of one command for lost ones, and refit the model to the commands that acted.

    The search is to first order around a fit, which the losses have bent; so search and fit take turns, the plainest
    losses first.

    Args:
        problem: Windows, with the commands that were sent.
        fit: Model whose residuals are to be explained.
        prior: Its prior.
        index: Which command.

    Returns:
        What was found; None where nothing was, where it would be more than half of the commands, or where there is no
        search (:func:`why_not_searched`).
    """
    windows = problem.windows
    sent = [c.column(index) for c in windows.commands]
    if all(np.ptp(u) == 0.0 for u in sent) or why_not_searched(windows) is not None:
        return None
    spans = _spans(windows)
    patterns = [np.zeros(len(u), dtype=bool) for u in sent]
    share, acted, now = SHARE, problem, fit
    best: LostCommands | None = None
    for turn in range(TURNS):
        before = patterns
        logs, price, last = _search(acted, now, index, spans, sent, before, share, FIRST ** (turn + 1))
        patterns = [shown.lost for shown in logs]
        if not any(p.any() for p in patterns):
            return None
        acted = FitProblem(problem.system, _acting(windows, index, patterns))
        now = acted.fit_one(Trial(fit.name, fit.free, prior, now.values, now.state, now.nuisance))
        found = _counted(index, logs, acted, now, price, sent)
        best = found if best is None or found.total < best.total else best
        share = float(np.clip(found.share, RARE, COMMON))
        if last and all((a == b).all() for a, b in zip(patterns, before, strict=True)):
            break
    if best is None or best.share > MOST_LOST or _imitated(best, index, spans, sent):
        return None
    return best


def _imitated(
    found: LostCommands, index: int, spans: Sequence[np.ndarray], sent: Sequence[np.ndarray]
) -> bool:
    """Whether offsets of the opposite sign, which no loss makes, would explain more.

    Whatever is irregular is explained in part by offsets at hundreds of places; only losses prefer one sign.
    """
    windows, real, opposite = found.problem.windows, 0.0, 0.0
    responses = _responses(found.problem, found.fit, index, spans, sent)
    for response, own, log in zip(responses, spans, windows.log, strict=True):
        given = sent[log][own[0] - 1 : own[-1] + 1]
        lost = found.logs[log].lost[own]
        # What the residuals are if nothing was lost.
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
    # A tick that is worth hardly more than its price is missed half the time.
    clear = worth > CLEAR * price
    clear = clear if clear.sum() >= MIN_CLEAR_TICKS else searched
    counts = int((lost & clear).sum()), int(clear.sum()), int(searched.sum()), int(lost.sum())
    return LostCommands(index, tuple(logs), problem, fit, *counts, price, tuple(sent))


def _spans(windows: Windows) -> list[np.ndarray]:
    """Per window, the ticks that may act in it."""
    spans = []
    for w, log in enumerate(windows.log):
        t = windows.commands[log].t
        first = int(np.searchsorted(t, windows.t0[w] - BEFORE * windows.length, side="right")) - 1
        last = int(np.searchsorted(t, windows.t0[w] + windows.length))
        # The first command of a log has nothing before it that could be held.
        spans.append(np.arange(max(first, 1), max(last, 2)))
    return spans


def _acting(windows: Windows, index: int, patterns: Sequence[np.ndarray]) -> Windows:
    """Windows with the commands that acted."""
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
    """One search of all windows.

    Args:
        problem, fit: Model under the pattern before.
        index: Which command.
        spans: Ticks of each window.
        sent: Commands of each log.
        before: Pattern before, of each log.
        share: Share of lost ticks that is expected.
        part: No tick is taken that wins less than this part of what the best one does.

    Returns:
        The ticks of every log, the price of a tick, and whether all that are worth it could be taken.
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
    # Where windows overlap a tick is lost if one of them says so.
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
    """For each window, what its measurements do when a command in one of its ticks is another one."""
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
    """For each log and each place in a ring of ticks, the commands with an offset in every tick of that place, so that
    no window sees two of them; and the offsets of every log.

    The offset is what a loss of the tick makes: what acts on commands need not be smooth.
    """
    commands, sizes = [], []
    for number, command in enumerate(windows.commands):
        acted = np.array(command.column(index), dtype=float)
        offset = np.append(0.0, acted[:-1] - sent[number][1:])
        least = SMALL * max(float(np.abs(sent[number]).max(initial=0.0)), 1e-12)
        # A tick whose loss changes nothing by itself still does beside other losses.
        offset = np.where(np.abs(offset) < least, least, offset)
        place = np.arange(len(acted)) % ring
        for k in range(ring):
            value = np.array(command.value, dtype=float)
            column = value if value.ndim == 1 else value[:, index]
            column[place == k] += offset[place == k]
            commands.append(CommandSeries(command.t, value))
        sizes.append(offset)
    return tuple(commands), sizes

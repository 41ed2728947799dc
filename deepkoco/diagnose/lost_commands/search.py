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

from deepkoco.diagnose.lost_commands.responses import Simulated, responses_to, simulated, ticks_of
from deepkoco.diagnose.lost_commands.sequence import Responses, held_over, offset_of, pattern
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.prior import Prior

MIN_REGULAR = 0.9  # share of regular ticks below which the duration of a lost tick is not defined
PACE = 1.5  # factor from the median interval within which a tick is regular
MOST_TICKS = 400  # commands in a window above which the search would take too long
MOST_LOST = 0.5  # share of lost commands above which the reason is not a loss but a delay
FIRST_SHARE = 0.1  # share of lost commands that the first round expects
MIN_SHARE, MAX_SHARE = 0.01, 0.3  # range of the share that later rounds expect
# Share of the best tick's fall of chi2 that other ticks need in the first round; its powers in the next rounds.
MIN_OF_BEST_TICK = 0.2
ROUNDS = 8  # largest number of rounds of search and fit
RENEWALS = 2  # times that a fit of a round may compute its slopes again, where fits keep them
CLEAR = (
    4.0  # fall of chi2 by the loss of a tick, in prices of a tick, from which the tick counts for the share
)
LARGE_STEPS = 1 / 3  # ticks with the largest steps of the command, whose losses explain most
MORE_TOGETHER = 1.5  # fall of the cost by a pattern, over the sum of what its ticks explain alone
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
        """Charge of the BIC."""
        return charge_of(self.found, self.searched, self.problem.windows.samples)

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
    most = max(len(own) for own in ticks_of(windows))
    if most > MOST_TICKS:
        return f"a window contains {most} commands; the search takes at most {MOST_TICKS}"
    if losing:
        which = " and ".join(str(k + 1) for k in losing)
        return f"losses of command {which} are not named: the healthy logs also lose some of its commands"
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
    search = _Search(problem, fit, prior, index, ticks_of(windows), sent)
    nothing = [np.zeros(len(u), dtype=bool) for u in sent]
    if search.promised() <= 0.0:
        return None
    if not search.keeps:
        return search.run(fit, nothing)
    # Most searches find nothing that may be named, so what they find is searched again without what is kept.
    found = search.run(fit, nothing, kept=True)
    if (
        found is None or found.total >= fit.cost
    ):  # a pattern that explains less than it is charged is named nowhere
        return None
    return search.run(found.fit, [shown.lost for shown in found.logs])


@dataclass(frozen=True)
class _Search:
    """A search in one command channel.

    Attributes:
        problem: Windows with the sent commands.
        fit: Model whose residuals are to be explained.
        prior: Its prior.
        index: Index of the command channel.
        spans: Ticks of each window.
        sent: Commands of each log.
    """

    problem: FitProblem
    fit: Fit
    prior: Prior
    index: int
    spans: Sequence[np.ndarray]
    sent: Sequence[np.ndarray]

    @property
    def keeps(self) -> bool:
        """Whether a simulation of all parameters and ticks takes so long that one can be kept for all rounds."""
        return self.problem.keeps_slopes([self._onward(self.fit)])

    def promised(self) -> float:
        """Return the largest fall of the cost by a pattern, less its charge, as single ticks promise it.

        Only the ticks with the largest steps of the command are asked. What they explain alone is added up, from the
        best one on.
        """
        windows, asked = self.problem.windows, []
        for own, log in zip(self.spans, windows.log, strict=True):
            step = np.abs(self.sent[log][own - 1] - self.sent[log][own])
            count = max(round(LARGE_STEPS * len(own)), 1)
            asked.append(own[np.sort(np.argsort(-step, kind="stable")[:count])])
        known = list(simulated(self.problem, self.fit, self.index, self.spans, self.sent, asked))
        worth = [np.zeros(len(u)) for u in self.sent]
        for response, own, log in zip(
            responses_to(windows, self.fit, asked, known), asked, windows.log, strict=True
        ):
            worth[log][own] = np.maximum(worth[log][own], self._worth(response, own, log))
        n = len({(log, tick) for own, log in zip(asked, windows.log, strict=True) for tick in own.tolist()})
        falls = -np.sort(-np.concatenate(worth))
        falls = MORE_TOGETHER * np.cumsum(falls[falls > 0.0])
        charges = [charge_of(k, n, windows.samples) for k in range(1, len(falls) + 1)]
        return float(np.max(falls - charges, initial=-math.inf))

    def _worth(self, response: Responses, own: np.ndarray, log: int) -> np.ndarray:
        """Return the fall of chi2 by the loss of each of some ticks alone."""
        step = self.sent[log][own - 1] - self.sent[log][own]
        return 2.0 * step * (response.residual @ response.change) - step**2 * response.size

    def run(self, now: Fit, patterns: Sequence[np.ndarray], kept: bool = False) -> LostCommands | None:
        """Search and fit in turns.

        Args:
            now: Model under a first pattern.
            patterns: This pattern, of every log.
            kept: Whether slopes and responses of the first round stand for those of all rounds. A pattern changes the
                commands and hardly the slopes.

        Returns:
            As :func:`lost_commands`.
        """
        problem, index = self.problem, self.index
        acted = self._acted(patterns)
        known = problem.slopes_at(now.values, now.free, now.state, now.nuisance) if kept else None
        raw = self._simulated(acted, now) if kept else None
        share, best = FIRST_SHARE, None
        for turn in range(ROUNDS):
            before = patterns
            part = MIN_OF_BEST_TICK ** (turn + 1)
            responses = self._responses(acted, now, raw)
            logs, price, last = self._shown(responses, before, share, part)
            patterns = [shown.lost for shown in logs]
            if not any(p.any() for p in patterns):
                return None
            acted = self._acted(patterns)
            renewals = RENEWALS if kept else None
            now = acted.fit([self._onward(now)], known=known, exact=not kept, renewals=renewals)[0]
            if now.diverged:
                return None
            found = _counted(index, logs, acted, now, price, self.sent)
            best = found if best is None or found.total < best.total else best
            share = float(np.clip(found.share, MIN_SHARE, MAX_SHARE))
            if last and all((a == b).all() for a, b in zip(patterns, before, strict=True)):
                break
        if best is None or best.share > MOST_LOST or self._imitated(best, raw):
            return None
        return best

    def _onward(self, fit: Fit) -> Trial:
        """Return a trial that starts where a fit ended."""
        return Trial(self.fit.name, self.fit.free, self.prior, fit.values, fit.state, fit.nuisance)

    def _acted(self, patterns: Sequence[np.ndarray]) -> FitProblem:
        """Return the problem with the commands that acted."""
        if not any(p.any() for p in patterns):
            return self.problem
        return FitProblem(self.problem.system, _acting(self.problem.windows, self.index, patterns))

    def _simulated(self, problem: FitProblem, fit: Fit) -> list[Simulated]:
        return list(simulated(problem, fit, self.index, self.spans, self.sent))

    def _responses(
        self, problem: FitProblem, fit: Fit, raw: Sequence[Simulated] | None
    ) -> Iterator[Responses]:
        raw = self._simulated(problem, fit) if raw is None else raw
        return responses_to(problem.windows, fit, self.spans, raw)

    def _shown(
        self, found: Iterator[Responses], before: Sequence[np.ndarray], share: float, part: float
    ) -> tuple[list[Shown], float, bool]:
        """Search all windows once.

        Args:
            found: Responses of each window under the previous pattern.
            before: Previous pattern of each log.
            share: Expected share of lost ticks.
            part: Share of the best tick's fall of chi2 that a tick needs.

        Returns:
            The ticks of every log, the price of a tick, and whether the price alone limited the search.
        """
        responses = list(found)
        price = max(2.0 * math.log((1.0 - share) / share), 0.0)
        most = 0.0
        for response, own, log in zip(responses, self.spans, self.problem.windows.log, strict=True):
            most = max(most, float(self._worth(response, own, log).max(initial=0.0)))
        bar = max(price, part * most)
        # In overlapping windows, a tick is lost if it is lost in one of them.
        logs = [Shown(np.zeros_like(p), np.zeros(len(p))) for p in before]
        for response, own, log in zip(responses, self.spans, self.problem.windows.log, strict=True):
            given = self.sent[log][own[0] - 1 : own[-1] + 1]
            logs[log].lost[own] |= pattern(response, given, before[log][own], bar, price)
            worth = np.diff(given) ** 2 * response.size
            logs[log].worth[own] = np.maximum(logs[log].worth[own], worth)
        return logs, price, bar == price

    def _imitated(self, found: LostCommands, raw: Sequence[Simulated] | None) -> bool:
        """Return whether offsets of the opposite sign, which no loss can cause, would explain more.

        Offsets at hundreds of ticks explain part of any irregular residual, with either sign. Real losses have one.
        """
        windows, real, opposite = found.problem.windows, 0.0, 0.0
        responses = self._responses(found.problem, found.fit, raw)
        for response, own, log in zip(responses, self.spans, windows.log, strict=True):
            given = self.sent[log][own[0] - 1 : own[-1] + 1]
            lost = found.logs[log].lost[own]
            # Residuals if nothing was lost.
            without = response.residual + response.change @ offset_of(given, lost)
            turned = response._replace(residual=-without)
            other = pattern(turned, given, np.zeros_like(lost), found.price, found.price)
            plain = without @ without
            real += plain - response.residual @ response.residual
            opposite += plain - ((without + response.change @ offset_of(given, other)) ** 2).sum()
        return bool(opposite > real)


def charge_of(lost: int, searched: int, samples: int) -> float:
    """Return the charge of the BIC: twice the logarithm of the number of patterns, and the share as one parameter."""
    patterns = math.lgamma(searched + 1) - math.lgamma(lost + 1) - math.lgamma(searched - lost + 1)
    return 2.0 * patterns + math.log(max(samples, 2))


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


def _acting(windows: Windows, index: int, patterns: Sequence[np.ndarray]) -> Windows:
    """Return the windows with the commands that acted."""
    commands = []
    for command, lost in zip(windows.commands, patterns, strict=True):
        value = np.array(command.value, dtype=float)
        column = value if value.ndim == 1 else value[:, index]
        column[:] = held_over(column.copy(), np.flatnonzero(lost))
        commands.append(CommandSeries(command.t, value))
    return replace(windows, commands=tuple(commands))

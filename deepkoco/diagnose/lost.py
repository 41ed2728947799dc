"""Commands that were sent and logged but never acted: the actuator held the one before for a tick.

Which ticks were lost is searched for in every window by itself. The response of the measurements to a small offset of
every single command is simulated once; a pattern of lost ticks then is a sum of such offsets of known sizes, and is
grown and shrunk tick by tick while the errors pay for saying where they are.

Source: matching pursuit with amplitudes that are known (Mallat and Zhang 1993), stopped by the two-part code of
    minimum description length (Rissanen 1978): N ticks of which a share p was lost take N H(p) to write down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.diagnosis import Estimate, Evidence, Finding
from deepkoco.diagnose.residuals import SLOTS, acting_system, dispersion, push_of
from deepkoco.diagnose.selection import Ranking, penalty
from deepkoco.identify.fit import Fit, FitProblem, Trial
from deepkoco.identify.prior import Prior
from deepkoco.identify.push import Push
from deepkoco.identify.simulate import predict
from deepkoco.identify.windows import CommandSeries, Windows

BEFORE = 0.15  # share of a window before it whose commands still act in it, through lags and delays
REGULAR = 0.9  # share of the ticks that follow at the usual pace, without which a lost one has no length
PACE = 1.5  # usual paces from which on a tick is late
SMALL = 1e-3  # offset that is simulated, in largest commands
SHARE = 0.1  # share of lost commands that a first search expects
RARE, COMMON = 0.005, 0.5  # shares that a second one may expect
SHOWS = 4.0  # fall of chi2 by a lost tick from which on it would show
WIDTHS = (
    1,
    2,
    3,
)  # neighbours that are turned over together: a loss that was put a tick off does not move alone
TURNS = 5  # of search and fit, at most
MOST = 400  # changes of a window's pattern, at most
LONGEST = 400  # ticks in a window, at most


@dataclass(frozen=True)
class LostCommands:
    """What was found.

    Attributes:
        index: Which command.
        patterns: Per log, (n,) whether each tick was lost.
        problem: The windows, with the commands that acted in the place of those that were sent.
        fit: Fit of the same model to them.
        lost: Ticks that were lost.
        ticks: Ticks of which it would have shown.
    """

    index: int
    patterns: tuple[np.ndarray, ...]
    problem: FitProblem
    fit: Fit
    lost: int
    ticks: int

    @property
    def share(self) -> float:
        """Share of the commands that were lost."""
        return self.lost / max(self.ticks, 1)

    @property
    def charge(self) -> float:
        """What the BIC charges: twice the logarithm of the number of patterns, and the share as a parameter."""
        p, samples = self.share, self.problem.windows.samples
        entropy = 0.0 if p in (0.0, 1.0) else -p * math.log(p) - (1.0 - p) * math.log(1.0 - p)
        return 2.0 * self.ticks * entropy + math.log(max(samples, 2))


def lost_commands(problem: FitProblem, fit: Fit, prior: Prior, index: int) -> LostCommands | None:
    """Search the ticks of one command for lost ones, and refit the model to the commands that acted.

    The search is to first order around a fit, which the losses have bent; so search and fit take turns.

    Args:
        problem: Windows, with the commands that were sent.
        fit: Model whose residuals are to be explained.
        prior: Its prior.
        index: Which command.

    Returns:
        What was found; None where nothing was, or where the stamps of the commands are not regular.
    """
    windows = problem.windows
    ticks = _ticks(windows)
    sent = [c.column(index) for c in windows.commands]
    if ticks is None or all(np.ptp(u) == 0.0 for u in sent):
        return None
    patterns = [np.zeros(len(u), dtype=bool) for u in sent]
    share, seen, acted = SHARE, 0, problem
    for _ in range(TURNS):
        before = [p.copy() for p in patterns]
        patterns, lost, seen = _search(acted, fit, index, ticks, sent, before, share)
        if lost == 0:
            return None
        if all((a == b).all() for a, b in zip(patterns, before, strict=True)):
            break
        share = float(np.clip(lost / max(seen, 1), RARE, COMMON))
        acted = FitProblem(problem.system, _acting(windows, index, patterns))
        fit = acted.fit([Trial(fit.name, fit.free, prior, fit.values, fit.state, fit.zero)])[0]
    lost = sum(int(p.sum()) for p in patterns)
    return LostCommands(index, tuple(patterns), acted, fit, lost, max(seen, lost))


class Losses(NamedTuple):
    """Lost commands that were accepted: what a report shows, the data with what acted, and the fit to them."""

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
    """Lost commands, where they explain more than the best candidate of a ranking.

    Args:
        problem, fit, prior: Model to be improved.
        causes: Lost commands at every command of the system.
        ranking: Candidates on top of the same fit.
        floor: chi2 per sample of a healthy unit.
        wanted: Fall of the BIC that they must reach.
    """
    best: tuple[float, Cause, LostCommands] | None = None
    for cause in causes:
        found = lost_commands(problem, fit, prior, cause.index)
        if found is not None and (best is None or found.fit.cost < best[0]):
            best = (found.fit.cost, cause, found)
    if best is None:
        return None
    cost, cause, found = best
    rival = ranking.best if ranking.candidates else None
    lowest = found.fit if rival is None or cost < rival.fit.cost else rival.fit
    spread = dispersion(lowest, problem.windows)
    deflation = max(spread.deflation, floor)
    ratio = fit.cost - cost
    score = ratio / deflation - found.charge
    least = wanted
    if rival is not None:
        places = SLOTS * len(problem.windows)
        charge = penalty(rival.cause, problem.windows.samples / spread.correlation, places)
        least = max(wanted, rival.likelihood_ratio / deflation - charge)
    if score <= least:
        return None
    needed = (found.charge + wanted) * deflation
    return Losses(_finding(found, cause, ratio, score, needed), found.problem, found.fit)


def _finding(found: LostCommands, cause: Cause, ratio: float, score: float, needed: float) -> Finding:
    n, p, z = max(found.ticks, 1), found.share, 1.96
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    reach = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    share = Estimate(p, max(middle - reach, 0.0), min(middle + reach, 1.0), "1")
    text = (
        f"{found.lost} of {found.ticks} commands whose loss would show were held over by the one before; simulating "
        f"them so lowers the squared error by {ratio:,.0f} noise variances; chance and saying which ones they are "
        f"explain up to {needed:,.0f}."
    )
    evidence = Evidence("likelihood_ratio", ratio, needed, text)
    own = {f"{cause.effect}.share": share}
    return Finding(cause.name, cause.family, (cause.name,), score, 1.0, own, (evidence,))


def _ticks(windows: Windows) -> np.ndarray | None:
    """(W, K) index of every tick that may act in each window; None where ticks are too irregular or too many."""
    paces = []
    for command in windows.commands:
        if len(command.t) < 20:
            return None
        gap = np.diff(command.t)
        if np.mean(gap < PACE * np.median(gap)) < REGULAR:
            return None
        paces.append(float(np.median(gap)))
    count = math.ceil((1.0 + BEFORE) * windows.length / min(paces)) + 1
    if count > LONGEST:
        return None
    first = np.empty(len(windows), dtype=int)
    for w, log in enumerate(windows.log):
        t = windows.commands[log].t
        begin = np.searchsorted(t, windows.t0[w] - BEFORE * windows.length, side="right") - 1
        first[w] = np.clip(begin, 1, max(len(t) - count, 1))
    shortest = min(len(c.t) for c in windows.commands)
    return first[:, None] + np.arange(min(count, shortest - 1))


def _acting(windows: Windows, index: int, patterns: Sequence[np.ndarray]) -> Windows:
    """Windows with the commands that acted."""
    commands = []
    for command, lost in zip(windows.commands, patterns, strict=True):
        value = np.array(command.value, dtype=float)
        column = value if value.ndim == 1 else value[:, index]
        column[:] = _held(column.copy(), np.flatnonzero(lost))
        commands.append(CommandSeries(command.t, value))
    return replace(windows, commands=tuple(commands))


def _search(
    problem: FitProblem,
    fit: Fit,
    index: int,
    ticks: np.ndarray,
    sent: Sequence[np.ndarray],
    before: Sequence[np.ndarray],
    share: float,
) -> tuple[list[np.ndarray], int, int]:
    """Patterns of lost ticks from those before, how many were lost and of how many it would have shown."""
    windows = problem.windows
    size = SMALL * max(float(np.abs(u).max(initial=0.0)) for u in sent)
    response, residual = _responses(problem, fit, index, ticks, size)
    gram = (response.mT @ response).numpy()
    match = (response.mT @ residual[..., None]).numpy()[..., 0]
    price = max(2.0 * math.log((1.0 - share) / share), 0.0)
    # Where windows overlap a tick is lost if one of them says so.
    patterns = [np.zeros_like(p) for p in before]
    visible = [np.zeros_like(p) for p in before]
    for w, log in enumerate(windows.log):
        own = ticks[w]
        lost, shows = _pattern(
            gram[w], match[w], sent[log][own[0] - 1 : own[-1] + 1], before[log][own], price
        )
        patterns[log][own] |= lost
        visible[log][own] |= shows
    lost = sum(int((p & v).sum()) for p, v in zip(patterns, visible, strict=True))
    return patterns, lost, sum(int(v.sum()) for v in visible)


def _responses(
    problem: FitProblem, fit: Fit, index: int, ticks: np.ndarray, size: float
) -> tuple[Tensor, Tensor]:
    """Whitened change (W, NM, K) by a unit offset of each tick, and the residuals (W, NM), both without what the
    initial states can do."""
    windows = problem.windows
    count, own, states = len(windows), ticks.shape[1], fit.state.shape[1]
    named = {
        n: torch.tensor(fit.values[n], dtype=torch.float64) for n in problem.names if n not in Push.NAMES
    }
    system = acting_system(problem, fit)
    theta = np.array([fit.values[n] for n in problem.names])
    # One copy of every log for each place in the ring of ticks: neighbouring windows do not see each other's offset.
    commands = []
    for command in windows.commands:
        place = np.arange(len(command.t)) % own
        for k in range(own):
            value = np.array(command.value, dtype=float)
            column = value if value.ndim == 1 else value[:, index]
            column[place == k] += size
            commands.append(CommandSeries(command.t, value))
    many = windows.take(np.repeat(np.arange(count), own))
    ring = (ticks % own).ravel()
    many = replace(
        many,
        commands=tuple(commands),
        log=many.log * own + ring,
        known=tuple(k for k in windows.known for _ in range(own)),
    )
    push = push_of(problem, theta)  # (J, 1, W, n)
    wide = None if push is None else push.repeat_interleave(own, 2)
    moved = predict(system, many, named, fit.state.repeat_interleave(own, 0)[None], wide)[0]
    tiny = 1e-6
    initial = fit.state[None].repeat(1 + states, 1, 1)
    for s in range(states):
        initial[1 + s, :, s] += tiny
    at = predict(system, windows, named, initial, push)
    weight = problem.weight
    change = moved.reshape(count, own, *moved.shape[1:]) - at[0][:, None]
    response = (change * weight[:, None]).reshape(count, own, -1).mT / size
    basis, _ = torch.linalg.qr(((at[1:] - at[0]) * weight).reshape(states, count, -1).permute(1, 2, 0))
    residual = fit.residual.reshape(count, -1)
    residual = residual - (basis @ (basis.mT @ residual[..., None]))[..., 0]
    return response - basis @ (basis.mT @ response), residual


def _pattern(
    gram: np.ndarray, match: np.ndarray, sent: np.ndarray, before: np.ndarray, price: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which of a window's ticks were lost (K,), and of which it would show (K,).

    Args:
        gram, match: Products of the responses with each other and with the residuals under the pattern before.
        sent: (K + 1,) commands, that before the first tick included.
        before: (K,) the pattern before.
        price: What a lost tick costs.
    """
    lost = before.copy()
    shows = np.diff(sent) ** 2 * np.diag(gram) > SHOWS
    acted = _held(sent, 1 + np.flatnonzero(before))[1:]

    def cost() -> float:
        offset = _held(sent, 1 + np.flatnonzero(lost))[1:] - acted
        return float(offset @ gram @ offset - 2.0 * offset @ match) + price * int(lost.sum())

    best = cost()
    for _ in range(MOST):
        turned, least = None, best - 1e-9
        open_to = np.flatnonzero(shows | lost)
        for wide in WIDTHS:
            for k in open_to:
                own = slice(k, k + wide)
                lost[own] ^= True
                tried = cost()
                lost[own] ^= True
                if tried < least:
                    turned, least = own, tried
            if turned is not None:
                break
        if turned is None:
            break
        lost[turned] ^= True
        best = least
    return lost, shows


def _held(sent: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Commands that acted when these ticks were lost: each holds what acted before it."""
    source = np.arange(len(sent))
    source[lost] = 0
    return sent[np.maximum.accumulate(source)]

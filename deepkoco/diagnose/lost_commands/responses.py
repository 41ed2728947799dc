"""Responses of the measurements to the loss of each single command, simulated once for each tick."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.diagnose.lost_commands.sequence import Responses, innovations
from deepkoco.diagnose.residuals.residuals import acting_system, push_of
from deepkoco.fit.data.usual_steps import with_usual_steps
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.simulate.simulator import predict

BEFORE = 0.15  # time before a window, as a share of its length, whose commands still act in it (lags, delays)
SMALL = 1e-3  # simulated offset where a command does not change, as a share of the largest command
LANES = 2000  # windows in one batch of simulations


class Simulated(NamedTuple):
    """Changes of one window's measurements, in noise standard deviations.

    Attributes:
        state: (S, n) change of every sample by the initial state, for each unit.
        change: (S, K) change of every sample by a unit offset of the command in each tick.
    """

    state: np.ndarray
    change: np.ndarray


def ticks_of(windows: Windows) -> list[np.ndarray]:
    """Return for each window the ticks that may act in it."""
    spans = []
    for w, log in enumerate(windows.log):
        t = windows.commands[log].t
        first = int(np.searchsorted(t, windows.t0[w] - BEFORE * windows.length, side="right")) - 1
        last = int(np.searchsorted(t, windows.t0[w] + windows.length))
        # The first command of a log has no previous command that could be held.
        spans.append(np.arange(max(first, 1), max(last, 2)))
    return spans


def simulated(
    problem: FitProblem,
    fit: Fit,
    index: int,
    spans: Sequence[np.ndarray],
    sent: Sequence[np.ndarray],
    asked: Sequence[np.ndarray] | None = None,
) -> Iterator[Simulated]:
    """Yield for each window how its measurements change with the command in each of its ticks.

    Args:
        problem: Windows under the previous pattern of losses.
        fit: Model around which they change.
        index: Index of the command channel.
        spans: Ticks of each window, of :func:`ticks_of`.
        sent: Sent commands of each log.
        asked: Ticks of each window that are simulated, of its ``spans``; None for all.
    """
    problem, fit = problem.as_fitted(fit)
    # Responses are differences of simulations, whose errors of the step are nearly the same.
    problem = FitProblem(problem.system, with_usual_steps(problem.windows, problem.system))
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
    slopes = problem.weighed(at[1:] - at[0]).flatten(2).permute(1, 2, 0)  # (W, samples, states)
    ring = max(len(own) for own in spans)
    spans = spans if asked is None else asked
    commands, sizes = _with_offsets(windows, index, ring, sent)
    block = max(LANES // ring, 1)
    for begin in range(0, len(windows), block):
        picked = list(range(begin, min(begin + block, len(windows))))
        rows = np.repeat(picked, [len(spans[w]) for w in picked])
        ticks = np.concatenate([spans[w] for w in picked])
        many = replace(windows, wander=None).take(rows)
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
        count = [len(spans[w]) for w in picked]
        change = (moved - at[0][row]) / size[:, None, None]
        for w, own in zip(picked, change.split(count), strict=True):
            # Whitened window by window: they share what noise of the commands does to it.
            response = problem.of_windows(torch.tensor([w])).weighed(own[:, None]).flatten(1)
            is_there = windows.valid[w].flatten().numpy()
            yield Simulated(slopes[w].numpy()[is_there], response.mT.numpy()[is_there])


def responses_to(
    windows: Windows, fit: Fit, spans: Sequence[np.ndarray], known: Sequence[Simulated]
) -> Iterator[Responses]:
    """Yield for each window the responses to its ticks, beside the residuals of a fit.

    Args:
        windows: The windows.
        fit: Fit whose residuals are to be explained.
        spans: Ticks of each window.
        known: Changes of each window, of :func:`simulated`.
    """
    for w, (own, of_window) in enumerate(zip(spans, known, strict=True)):
        is_there = windows.valid[w].flatten().numpy()
        residual = fit.residual[w].flatten().numpy()[is_there]
        t = windows.t[w].flatten().numpy()[is_there]
        ticks = windows.commands[windows.log[w]].t[own] - windows.t0[w]
        yield innovations(of_window.state, of_window.change, residual, t, ticks)


def _with_offsets(
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

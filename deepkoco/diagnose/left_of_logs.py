"""What simulations of a robot, as a machine or by an engine, leave of some windows of its logs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline, Near, baseline_from
from deepkoco.diagnose.baseline_refit import (
    SlopesOfHalves,
    few_windows,
    from_shorter_windows,
    on_half_windows,
    slopes_on_half_windows,
)
from deepkoco.diagnose.causes.timing import STARTS
from deepkoco.diagnose.late_speeds import with_late_speeds
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.own_steps import in_steps_of
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.fit import ITERATIONS, Fit, FitProblem, Trial
from deepkoco.fit.solve.command_noise import LEFT, with_command_noise, with_noise_like
from deepkoco.fit.solve.fine_steps import MOST, fine_steps, parts_of, with_steps_cut
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import System

# Fall of the cost, in noise variances that the better one leaves, from which it counts. Logs without rest and with much
# noise leave both alike.
MARGIN = 10.0
# Share that is left where something that matters is changed: a robot that its file describes badly leaves a little less
# with any change.
LESS = 0.5
# Times what is left of most windows, from which something happened in one: a model error differs less between them.
STANDS_OUT = 10.0
FAR = 1000.0  # noise variances from which a fit has not come near the logs
NOISE = 1.2  # noise variances that a simulation leaves of its own logs
# Iterations of further fits of many parameters. Each begins where the one before ended, and other steps change little.
# A robot that its file describes badly would go on for long. The first of them show whether a delay matters.
FURTHER, FIRST = 16, 4
ENOUGH = 1.0  # fall of the cost by a step below which a fit has told what a law leaves: little beside MARGIN
DELAYS = ("actuation_delay(all).delay", "actuation_delay.delay")  # of several commands, and of one
EARLIEST = 0.5  # rows of a log by which commands act before their row at most
CLEAR = 3.0  # standard deviations of a lead from which it is one


class Left(NamedTuple):
    """What a simulation leaves of logs.

    Attributes:
        cost: chi2 and squared distance from the prior.
        per_sample: chi2 of one sample.
        values: Parameters of the simulation; None where nobody needs them.
    """

    cost: float
    per_sample: float
    values: Mapping[str, float] | None = None

    def __str__(self) -> str:
        """What is left, without the parameters."""
        return f"{self.cost:.6g} ({self.per_sample:.4g} a sample)"

    def less_than(self, other: Left) -> bool:
        """Whether it leaves so much less than another that this counts."""
        return other.cost - self.cost > MARGIN * max(self.per_sample, 1.0)


class OnTime(NamedTuple):
    """A law that has commands when they are logged, or later, and what it leaves of the logs."""

    law: System
    left: Left


class Early(NamedTuple):
    """What a law leaves of the logs with commands that act before their rows.

    Attributes:
        left: What is left.
        lead: Time by which they do [s].
    """

    left: Left
    lead: float


class LeftOfLogs:
    """Refits on halves of some windows; each begins at the values of the one before.

    Args:
        windows: The windows, cut for the robot as a machine.
        near: What earlier fits of the logs have told; None for none.
        logged: Their commands as logged; None for those of the windows.
    """

    def __init__(
        self, windows: Windows, near: Near | None = None, logged: tuple[CommandSeries, ...] | None = None
    ) -> None:
        self.windows, self.logged = windows, windows.commands if logged is None else logged
        self._near = near
        self._values: dict[str, float] = {} if near is None else {**near.values}
        self._each = np.zeros(len(windows))  # chi2 per sample of each window that the last refit saw
        self._parts = 1 if near is None else parts_of(windows, near.step)  # of a step of the machine
        self._on_time: dict[tuple[str | None, tuple[str, ...]], OnTime] = {}
        self._last: tuple[Baseline, Windows, Fit] | None = None  # refit, under the present noise
        self._slopes: SlopesOfHalves | None = None

    def __call__(self, law: System) -> Left:
        """Refit the parameters of the robot, and say what is left.

        Raises:
            DivergedError: The simulation diverges.
        """
        start, windows = self._start(law)
        names = start.prior.names
        if self._near is not None and windows.wander is None:
            problem_of = partial(FitProblem, start.system)
            noisy = with_noise_like(problem_of, windows, start.values, self._near.wander)
            windows = windows if noisy is windows else self._kept_noise(noisy)
        fit = self._refit(start, windows, names)
        if law.engine is None and windows.wander is None and fit.chi2 > NOISE * max(windows.samples, 1):
            state = windows.state.clone()
            state[torch.from_numpy(few_windows(windows, len(names)))] = fit.state[::2]
            noisy = with_command_noise(partial(FitProblem, start.system), windows, fit.values, state)
            if noisy is not windows:
                windows = self._kept_noise(noisy)
                start = replace(start, values={**start.values, **{n: fit.values[n] for n in names}})
                fit = self._refit(start, windows, names)
        if law.engine is None and fit.chi2 > NOISE * max(windows.samples, 1):
            # Steps that are too long for these logs leave something, too, and an engine's own are shorter.
            problem_of = partial(FitProblem, start.system)
            halves = halved(windows.take(few_windows(windows, len(names))))
            parts = fine_steps(problem_of, halves, fit, MOST // self._parts) if self._parts < MOST else 1
            if parts > 1:
                self._parts *= parts
                trial = Trial("fine steps", names, start.prior, fit.values, fit.state, fit.nuisance)
                fit = problem_of(with_steps_cut(halves, parts)).fit_one(trial)
        own = (fit.residual**2).flatten(1).sum(1).reshape(-1, 2).sum(1)  # both halves of each window
        chosen = few_windows(windows, len(names))
        self._each[chosen] = own.numpy() / windows.valid[chosen].flatten(1).sum(1).clamp_min(1).numpy()
        return self._kept(law, fit, names)

    @property
    def on_time(self) -> OnTime | None:
        """The law that leaves least of those that have commands when they are logged, or later; None where none is.

        An engine has them half a step early, so these are the machine and an engine whose steps are short.
        """
        return min(self._on_time.values(), key=lambda own: own.left.cost, default=None)

    @property
    def noise(self) -> float:
        """Noise variances that a simulation leaves of its own logs at most."""
        return NOISE if self.windows.wander is None else NOISE + LEFT

    def near(self, law: System, left: Left, lead: float = 0.0) -> Near | None:
        """Return what the fit of a law tells of further ones; None where it has not come near the logs.

        Args:
            law: The robot, as a machine or by an engine.
            left: What it leaves.
            lead: Time by which its commands act before their rows [s].
        """
        if left.values is None or left.per_sample > FAR:
            return None
        # Delays of commands and speeds may be what is hidden in the logs, so they are told apart from the rest.
        body = baseline_from(law, self.windows).prior.names
        known = {n: v for n, v in left.values.items() if n in body}
        wander = self.windows.wander
        if wander is not None and (law.engine is not None or lead > 0.0):
            # It was found beside a machine. What an engine does otherwise, or early, could be taken for it.
            commands = _moved(self.logged, lead)
            windows = in_steps_of(replace(self.windows, commands=commands, wander=None), law)
            start = baseline_from(law, windows)
            values = {**start.values, **{n: v for n, v in left.values.items() if n not in DELAYS}}
            wander = with_command_noise(
                partial(FitProblem, start.system), windows, values, windows.state
            ).wander
        wander = None if wander is None else wander.take(torch.zeros(0, dtype=torch.long))
        step = self.windows.step / self._parts if self._parts > 1 else math.inf
        delays = {n: v for n, v in left.values.items() if n not in body and v > 0.0}
        return Near(known, wander, step, delays)

    def undisturbed(self) -> Windows:
        """The windows of which no more is left than of most: in the others something happened, such as a push.

        They say nothing of the steps of an engine, and more than all others together.
        """
        quiet = self._each <= STANDS_OUT * max(float(np.median(self._each)), NOISE)
        return self.windows.take(quiet) if (~quiet).sum() <= len(quiet) // 3 else self.windows

    def late(self, law: System, than: Left | None = None) -> Left:
        """As a call, with commands that act later than they are sent, by a time that is fitted too.

        Args:
            law: The robot.
            than: What is left without; a fit of many parameters that begins to leave much less than this goes on.

        Raises:
            DivergedError: The simulation diverges.
        """
        start, windows = self._start(law)
        declared = {p.name: p for p in start.system.parameters}
        name = next((n for n in DELAYS if n in declared), None)
        if name is None:
            return self(law)
        prior, halves = start.prior.widened([declared[name]], start.values), halved(windows)
        problem = FitProblem(start.system, halves)
        state, _ = problem.fit_states(start.values, halves.state)
        begins = [self._values[name]] if name in self._values else STARTS
        trials = [Trial("late", prior.names, prior, {**start.values, name: at}, state) for at in begins]
        steps = self._iterations(halves, prior.names)
        some = FIRST if than is not None and steps < ITERATIONS else steps
        fits = [fit for fit in problem.fit(trials, some) if not fit.diverged]
        if not fits:
            raise DivergedError("a simulation with late commands diverges")
        best = min(fits, key=lambda fit: fit.cost)
        if than is not None and some < steps and best.cost <= LESS * than.cost:
            trial = Trial("late", prior.names, prior, best.values, best.state, best.nuisance)
            fits = [best, *(fit for fit in problem.fit([trial], steps) if not fit.diverged)]
        return self._kept(law, min(fits, key=lambda fit: fit.cost), prior.names)

    def early(self, law: System) -> Early | None:
        """As a call, with commands that act before their rows by a time that is fitted too; None where none do.

        Commands that are half a row early and late by a free delay act up to half a row early, or late.

        Args:
            law: The robot.

        Raises:
            DivergedError: The simulation diverges.
        """
        start, windows = self._start(law)
        declared = {p.name: p for p in start.system.parameters}
        name = next((n for n in DELAYS if n in declared), None)
        rows = [float(np.median(np.diff(c.t))) for c in windows.commands if c.changes and len(c.t) > 2]
        if name is None or not rows:
            return None
        most = EARLIEST * min(rows)
        halves = halved(replace(windows, commands=_moved(windows.commands, most)))
        problem = FitProblem(start.system, halves)
        begin = start.values[name] + most
        values = {**start.values, name: begin}
        prior = start.prior.widened([declared[name]], values)
        state, _ = problem.fit_states(values, halves.state)
        trial = Trial("early", prior.names, prior, values, state)
        (fit,) = problem.fit([trial], self._iterations(halves, prior.names), ENOUGH)
        if fit.diverged:
            raise DivergedError("a simulation with early commands diverges")
        lead = begin - fit.values[name]
        spread = max(1.0, fit.chi2 / max(self.windows.samples, 1))
        k = fit.free.index(name)
        clear = lead > CLEAR * float(np.sqrt(spread * fit.covariance[k, k]))
        known = {n: fit.values[n] for n in start.prior.names}
        left = Left(fit.cost, fit.chi2 / max(self.windows.samples, 1), {**self._values, **known})
        return Early(left, lead) if clear else None

    def _refit(self, start: Baseline, windows: Windows, names: tuple[str, ...]) -> Fit:
        """Fit half windows, with the slopes of a law before where there are many parameters.

        Other steps of an engine hardly change the slopes, whose simulations are most of the work of such a fit. The
        first fit begins on shorter windows where it diverges, or does not come near the logs.
        """
        if self._slopes is None and self._last is not None:
            self._slopes = slopes_on_half_windows(*self._last)
        try:
            fit = on_half_windows(
                start, windows, names, self._iterations(windows, names), ENOUGH, self._slopes
            )
            far = fit.chi2 > FAR * max(windows.samples, 1)
        except DivergedError:
            if self._values:
                raise
            fit, far = None, True
        if far and not self._values:
            shorter = from_shorter_windows(start, windows, names)
            fit = shorter if fit is None or shorter.cost < fit.cost else fit
        assert fit is not None
        self._last = start, windows, fit
        return fit

    def _iterations(self, windows: Windows, names: Sequence[str]) -> int:
        many = len(names) + windows.state.shape[1] >= MANY
        return FURTHER if many and self._values else ITERATIONS

    def _kept_noise(self, noisy: Windows) -> Windows:
        """Keep the noise of the commands of windows, which does nearly the same whatever the law; return these."""
        self._slopes, self._last = None, None
        self._on_time.clear()
        self.windows = replace(self.windows, commands=noisy.commands, wander=noisy.wander, noise=noisy.noise)
        return noisy

    def _start(self, law: System) -> tuple[Baseline, Windows]:
        start = with_late_speeds(baseline_from(law, self.windows), self.windows)
        windows = in_steps_of(self.windows, law)
        windows = with_steps_cut(windows, self._parts) if law.engine is None else windows
        return replace(start, values={**start.values, **self._values}), windows

    def _kept(self, law: System, fit: Fit, names: tuple[str, ...]) -> Left:
        self._values.update({name: fit.values[name] for name in names})
        left = Left(fit.cost, fit.chi2 / max(self.windows.samples, 1), dict(self._values))
        if not law.engine_step:
            key, own = (law.engine, names), OnTime(law, left)
            self._on_time[key] = min(self._on_time.get(key, own), own, key=lambda each: each.left.cost)
        return left


def _moved(commands: tuple[CommandSeries, ...], lead: float) -> tuple[CommandSeries, ...]:
    """Return commands that act some time [s] before they are logged."""
    return commands if lead == 0.0 else tuple(replace(c, t=c.t - lead) for c in commands)

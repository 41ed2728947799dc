"""Gain: held-out error of the simulation as given, refitted and extended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, kind_of
from deepkoco.diagnose.evidence.event_windows import as_in, of_same_logs, refit_elsewhere, touched
from deepkoco.diagnose.evidence.flexible import PUSHES
from deepkoco.diagnose.refitted import Refitted
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.part import seconds
from deepkoco.systems import ExtendedSystem

RESAMPLES = 2000
BINS = 20  # of the error-by-horizon curve


@dataclass(frozen=True)
class ChannelGain:
    """Root mean square simulation error of one channel over the held-out windows, in its unit."""

    name: str
    unit: str
    baseline: float
    refit: float
    extended: float


@dataclass(frozen=True)
class Gain:
    """Held-out error of three simulations.

    The parameters come from the training windows. The initial state of each window (and own parameters of a hold-out
    log) are fitted on the held-out windows themselves, in the same way for each simulation.

    Attributes:
        channels: Errors by channel.
        reduction: 1 - extended / refit, of the first channel of every joint together, each in units of its noise.
        low: Lower end of its 95 % interval, bootstrap over windows.
        high: Upper end.
        windows: Number of held-out windows.
        horizon: Length of a window [s].
        curve_time: (BINS,) time since the window's start [s].
        curves: model -> channel -> (BINS,) error over time.
        replayed: The held-out windows.
        fits: model -> fit on the held-out windows.
        as_given: Whether the extended simulation keeps every parameter as given, or as learned from healthy logs.
    """

    channels: tuple[ChannelGain, ...]
    reduction: float
    low: float
    high: float
    windows: int
    horizon: float
    curve_time: np.ndarray
    curves: dict[str, dict[str, np.ndarray]]
    replayed: Windows
    fits: dict[str, Fit]
    as_given: bool = False


def gain_on_held_out(base: Refitted, final: Fit, accepted: Sequence[Cause], seed: int) -> Gain | None:
    """Measure the selected causes on the held-out windows.

    Args:
        base: The refitted baseline.
        final: Fit with the causes; the refit itself where there are none.
        accepted: The causes.
        seed: Seed of the bootstrap.

    Returns:
        The gain; None where there are no held-out windows, where a push acts in all of them, or where one of their
        simulations diverges.
    """
    if base.held is None:
        return None
    refit, held = base.reference, base.held
    if final is not refit and any(c.effect == "event" for c in accepted):
        refit = refit_elsewhere(base.start, base.train, refit, final)
        if of_same_logs(held, base.train):
            # What lasts is measured where nothing happens; a long push acts in windows that are held out, too.
            held = held.take(~touched(held, final.values))
        if len(held) == 0:
            return None
    return gain_of_fits(base.problem, base.start, held, refit, final, seed)


def gain_of_fits(
    problem: FitProblem, start: Baseline, held: Windows, refit: Fit, extended: Fit, seed: int
) -> Gain | None:
    """Measure two fits of the training windows, and the baseline before them, on the held-out windows.

    Args:
        problem: The fit of the training windows.
        start: The baseline.
        held: Held-out windows.
        refit: The refitted baseline.
        extended: The fit with causes or with a learned load.
        seed: Seed of the bootstrap.

    Returns:
        The gain; None where one of the simulations diverges.
    """
    models = {
        "baseline": start.values,
        "refit": as_in(held, refit.values, problem.windows),
        "extended": as_in(held, extended.values, problem.windows),
    }
    windows = {
        "baseline": replace(held, varies={}),
        "refit": problem.elsewhere(held, refit),
        "extended": problem.elsewhere(held, extended),
    }
    return held_out_gain(start.system, windows, models, seed)


def held_out_gain(
    system: ExtendedSystem,
    windows: Windows | Mapping[str, Windows],
    models: Mapping[str, Mapping[str, float]],
    seed: int,
) -> Gain | None:
    """Simulate held-out windows with each model; return None if one of these simulations diverges.

    Args:
        system: The system with every effect.
        windows: Held-out windows, or for each model the windows with what it knows about differences between logs.
        models: "baseline", "refit" and "extended" -> parameter values.
        seed: Seed of the bootstrap.
    """
    told = windows if isinstance(windows, Mapping) else dict.fromkeys(models, windows)
    fits: dict[str, Fit] = {}
    for one, own in told.items():
        if one in fits:
            continue
        # Models with the same knowledge about the windows share a batch.
        alike = [n for n in models if told[n].known == own.known and told[n].varies == own.varies]
        distinct = [n for n in alike if not any(models[m] == models[n] for m in alike if m < n)]
        problem = FitProblem(system, own)
        states = _suited(problem, [models[n] for n in distinct])
        trials = [Trial(n, (), Prior.empty(), models[n], states[k]) for k, n in enumerate(distinct)]
        found = dict(zip(distinct, problem.fit(trials, 12 if problem.nuisances.count else 1), strict=True))
        fits |= {n: next(fit for m, fit in found.items() if models[m] == models[n]) for n in alike}
    if any(fit.diverged for fit in fits.values()):
        return None
    return _measured(system, told["baseline"], fits, seed)


def kept_as_given(gain: Gain, system: ExtendedSystem, seed: int) -> Gain | None:
    """Return the gain with every parameter as given; None if the extended simulation fits these windows no worse."""
    if gain.fits["extended"].chi2 <= gain.fits["baseline"].chi2:
        return None
    fits = {**gain.fits, "extended": gain.fits["baseline"]}
    return replace(_measured(system, gain.replayed, fits, seed), as_given=True)


def _measured(system: ExtendedSystem, windows: Windows, fits: Mapping[str, Fit], seed: int) -> Gain:
    error = {name: windows.errors(fit.residual).numpy() for name, fit in fits.items()}
    valid = windows.valid.numpy()
    channels = []
    for c, channel in enumerate(system.measurements):
        if valid[:, c].any():
            rms = {name: _rms(e[:, c], valid[:, c]) for name, e in error.items()}
            channels.append(
                ChannelGain(channel.name, channel.unit, rms["baseline"], rms["refit"], rms["extended"])
            )
    square = {name: _judged(system, fit.residual.numpy(), valid) for name, fit in fits.items()}
    rng = np.random.default_rng(seed)
    picks = rng.integers(0, len(windows), (RESAMPLES, len(windows)))
    ratio = np.sqrt(square["extended"][picks].sum(1) / square["refit"][picks].sum(1).clip(1e-300))
    low, high = np.quantile(1.0 - ratio, [0.025, 0.975])
    edges = np.linspace(0.0, windows.length, BINS + 1)
    t = windows.t.numpy()
    curves: dict[str, dict[str, np.ndarray]] = {}
    for name, e in error.items():
        curves[name] = {}
        for c, channel in enumerate(system.measurements):
            if valid[:, c].any():
                inside = [valid[:, c] & (t[:, c] >= a) & (t[:, c] < b) for a, b in pairwise(edges)]
                curves[name][channel.name] = np.array([_rms(e[:, c], m) for m in inside])
    return Gain(
        tuple(channels),
        float(1.0 - np.sqrt(square["extended"].sum() / max(square["refit"].sum(), 1e-300))),
        float(low),
        float(high),
        len(windows),
        windows.length,
        0.5 * (edges[:-1] + edges[1:]),
        curves,
        windows,
        dict(fits),
    )


def _judged(system: ExtendedSystem, residual: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Squared errors of each window (W,), in noise variances, that the reduction compares.

    Each joint counts with its first measured channel: a cause at one joint may leave all others as they are. A system
    whose channels show no joint counts with its first channel.
    """
    shown = [c for c in range(valid.shape[1]) if valid[:, c].any()]
    first: dict[int, int] = {}
    for c in shown:
        state = system.measured_states[c]
        first.setdefault(state % system.joints if state < 2 * system.joints else 0, c)
    chosen = sorted(first.values())
    return (residual[:, chosen] ** 2 * valid[:, chosen]).sum((1, 2))


def note_on_gain(
    named: Sequence[str], learned: bool, as_given: bool = False, changed_s: float | None = None
) -> str:
    """Return on which windows the gain is measured, and which decisions also used them.

    Args:
        named: Names of the causes in the extended simulation.
        learned: Whether the extended simulation has a learned load instead.
        as_given: Whether the extended simulation keeps every parameter as given.
        changed_s: Time from which the unit is another one [s], if it changed in the middle of its log.
    """
    note = "No fit uses these windows."
    refit = "The refit is"
    if changed_s is not None:
        note += f" Windows of this log are of the unit from {seconds(changed_s)} s on."
    if changed_s is not None and not named:
        refit = "The refits of the whole log and of this part are"
    if as_given:
        return (
            f"{note} {refit} worse on them than the simulation as given (or as learned from healthy logs), so "
            "model.yaml keeps the parameters as given."
        )
    if changed_s is not None and not named:
        return (
            f"{note} model.yaml has the parameters that this part shows, as those of the unit as it is now."
        )
    if any(name.startswith("lost_commands") for name in named):
        note += " The lost commands in them are not known, so all sent commands act in the simulation."
        if len(named) == 1:
            return f"{note} Knowing that commands are lost therefore gains nothing here."
    if named and all(kind_of(name) in PUSHES for name in named):
        return f"{note} The push acts in none of them. It is left out, so there is no gain."
    if named:
        note += (
            " If structure remains or several causes are named, these windows also helped to decide which causes are "
            "named. The gain is then slightly optimistic."
        )
    if learned:
        note += " They also decided that the learned load is kept, so the gain is slightly optimistic."
    if any(kind_of(name) in PUSHES for name in named):
        note += " The push acts in none of them and is left out."
    return note


def _suited(problem: FitProblem, models: Sequence[Mapping[str, float]]) -> torch.Tensor:
    """Fit the initial states (K, W, S) of each model on each window, all models in one batch.

    Each window takes the best of three starts: its own guess, the fit of its first half (a short window has
    fewer minima), and the state fitted for the last model, which is usually the best one.
    """
    windows, count = problem.windows, len(models)
    halves = FitProblem(problem.system, halved(windows))
    short = halves.fit_states_each(models, halves.windows.state.repeat(count, 1, 1))[0][:, ::2]
    starts = torch.cat([windows.state.repeat(count, 1, 1), short])
    states, costs = problem.fit_states_each([*models, *models], starts)
    states, costs = states.unflatten(0, (2, count)), costs.unflatten(0, (2, count))
    best = _pick(states, costs)
    again, cost = problem.fit_states_each(models, best[-1:].repeat(count, 1, 1))
    return _pick(torch.stack([best, again]), torch.stack([costs.min(0).values, cost]))


def _pick(states: torch.Tensor, costs: torch.Tensor) -> torch.Tensor:
    """Return the states (K, W, S) with the lowest cost over the first axis."""
    costs = torch.where(torch.isfinite(costs), costs, torch.inf)
    index = costs.argmin(0)[None, ..., None].expand(1, *states.shape[1:])
    return states.gather(0, index)[0]


def _rms(error: np.ndarray, valid: np.ndarray) -> float:
    return float(np.sqrt((error[valid] ** 2).mean())) if valid.any() else float("nan")

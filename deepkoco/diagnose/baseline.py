"""The baseline: the system as it is, and the system refitted within its own parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.run_to_run import RunToRun
from deepkoco.fit.data.windows import Windows, halved
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.residual_noise import sharpen_noise
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.effects import effects_of
from deepkoco.systems.effects.learned import is_weight


@dataclass(frozen=True)
class Healthy:
    """Healthy logs of the unit, and what explains them.

    Attributes:
        recordings: The logs.
        windows: Their windows, with the noise that they show.
        before: The baseline before it learned from them.
        causes: Causes of the catalogue that they asked for.
        fit: Fit with these.
    """

    recordings: tuple[Recording, ...]
    windows: Windows
    before: Baseline
    causes: tuple[Cause, ...]
    fit: Fit


@dataclass(frozen=True)
class Baseline:
    """What the diagnosis takes for granted before it looks for causes.

    Attributes:
        system: The base system with every effect of the registry, at its present values.
        values: Present value of every parameter, pushes included.
        prior: Over the parameters that every fit frees.
        floor: chi2 per sample that this unit shows when nothing is wrong.
        correlation: Samples per independent sample of what the model misses then; asked of several healthy logs only.
        effects: Effects that a healthy log of the unit asked for, part of the baseline from then on.
        losing: Numbers of the commands of which a healthy log lost some, too.
        healthy: The healthy logs that it was learned from, if any.
        runs: What these logs show when each has parameters of its own; None for less than two.
    """

    system: ExtendedSystem
    values: dict[str, float]
    prior: Prior
    floor: float = 1.0
    correlation: float = 1.0
    effects: tuple[str, ...] = ()
    losing: tuple[int, ...] = ()
    healthy: Healthy | None = None
    runs: RunToRun | None = None

    @property
    def least_deflation(self) -> float:
        """Factor by which likelihood ratios are too large on any log of this unit."""
        return self.floor * self.correlation

    @property
    def healthy_lag_one(self) -> float:
        """Correlation of neighbouring residuals that this unit shows when nothing is wrong."""
        if self.healthy is None:
            return 0.0
        if self.runs is not None:
            return max(self.runs.lag_one, 0.0)
        return max(dispersion(self.healthy.fit, self.healthy.windows).lag_one, 0.0)


class BaselineError(ValueError):
    """A baseline that was learned before does not fit what it is given with."""


def check_learned(baseline: Baseline, system: System) -> None:
    """Check that a baseline was learned on this very system.

    Args:
        baseline: What was learned.
        system: The system of the diagnosis.

    Raises:
        BaselineError: It was learned on another one, or on the same with other values.
    """
    learned, wanted = baseline.system, catalogue_system(system)
    if type(learned.base) is not type(wanted.base):
        raise BaselineError(
            f'the baseline was learned on "{learned.name}", the diagnosis is of "{wanted.name}"; learn it on '
            f'"{wanted.name}"'
        )
    had = {p.name: p.value for p in learned.parameters}
    other = [p for p in wanted.parameters if had.get(p.name) != p.value]
    if other or len(had) != len(wanted.parameters):
        first = other[0] if other else None
        what = (
            ""
            if first is None
            else f": {first.name} was {had.get(first.name)}, now {first.value} {first.unit}"
        )
        raise BaselineError(
            f'the baseline was learned on another "{learned.name}" than that of the diagnosis{what}; learn it on the '
            "same model"
        )


def catalogue_system(system: System) -> ExtendedSystem:
    """The system with every effect: those that it does not have yet are at their null values."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    return ExtendedSystem(base, tuple(effects_of(base)), {p.name: p.value for p in system.parameters})


def baseline_from(system: System, windows: Windows) -> Baseline:
    """Start of a diagnosis that knows nothing but the system's declared parameters and priors."""
    extended = catalogue_system(system)
    values = {p.name: p.value for p in extended.parameters}
    values |= {name: p.value for name, p in Push.declared(extended, windows).items()}
    # Learned weights stand for no mechanism whose change has a name: they give way as the system's own values do.
    own = [p for p in extended.parameters if "." not in p.name or (is_weight(p.name) and p.value != 0.0)]
    return Baseline(extended, values, Prior.of(own))


def refit(start: Baseline, windows: Windows, free: tuple[str, ...] | None = None) -> Fit:
    """Fit the baseline's parameters under their prior, first on windows of half the length.

    A long window across an unstable equilibrium has many minima; the half windows have fewer, and give
    both the parameters and the initial states from which the long ones start.

    Args:
        start: Prior and present values.
        windows: The windows to fit.
        free: Parameters to free; None frees all that the prior covers.
    """
    names = start.prior.names if free is None else free
    halves = halved(windows)
    short = FitProblem(start.system, halves)
    state, _ = short.fit_states(start.values, halves.state)
    first = short.fit_one(Trial("half windows", names, start.prior, start.values, state))
    problem = FitProblem(start.system, windows)
    guess = first.state[::2]
    state, _ = problem.fit_states(first.values, guess)
    return problem.fit_one(Trial("refit", names, start.prior, first.values, state, first.nuisance))


def refit_sharply(start: Baseline, windows: Windows) -> tuple[Windows, Fit]:
    """Refit, estimate the noise from what the refit leaves, and refit once more under that noise."""
    rough = refit(start, windows)
    windows = replace(windows, noise=sharpen_noise(windows, rough))
    problem = FitProblem(start.system, windows)
    trial = Trial("refit", rough.free, start.prior, rough.values, rough.state, rough.nuisance)
    return windows, problem.fit_one(trial)


def with_floor_as_noise(start: Baseline, windows: Windows) -> tuple[Baseline, Windows, Fit]:
    """Take the model-error floor for noise, and refit.

    The prior of a baseline that was learned knows the floor; a likelihood that does not would overrule it, and so would
    one that takes neighbouring model errors for independent.

    Args:
        start: A baseline learned from healthy logs.
        windows: Windows with the noise of the sensors alone.

    Returns:
        The baseline with a floor of 1, the windows with the larger noise, and their refit.
    """
    windows = noisier(windows, start.floor, start.correlation)
    start = replace(start, floor=1.0, prior=tempered(start.prior, start.correlation))
    first = refit(start, windows)
    trial = Trial("refit", first.free, start.prior, first.values, first.state, first.nuisance)
    return start, windows, FitProblem(start.system, windows).fit_one(trial)


def prior_of_mean(start: Baseline) -> tuple[Baseline, dict[str, float]]:
    """A baseline whose prior is that of the mean of all logs, and the standard deviations by which each differs.

    Args:
        start: Learned from several healthy logs; its prior is that of one further log.
    """
    assert start.healthy is not None
    assert start.runs is not None
    prior, varies = start.prior, start.healthy.windows.varies
    apart = np.diag(start.runs.doubted)
    shared = np.array([v if n in varies else 0.0 for n, v in zip(prior.names, apart, strict=True)])
    mean = replace(prior, covariance=prior.covariance - np.diag(shared))
    return replace(start, prior=mean), dict(varies)


def noisier(windows: Windows, floor: float, correlation: float = 1.0) -> Windows:
    """Windows whose noise has this many times its variance, and whose spread weighs as :func:`tempered` has it."""
    return replace(
        windows,
        noise=tuple(n._replace(sd=math.sqrt(floor) * n.sd) for n in windows.noise),
        varies={n: sd / math.sqrt(correlation) for n, sd in windows.varies.items()},
    )


def tempered(prior: Prior, correlation: float) -> Prior:
    """A prior for a cost in which each sample counts in full, though only one in so many is independent.

    Likelihood ratios and covariances of such fits are deflated by as much, which gives the prior its own weight back.
    """
    return Prior(prior.names, prior.centre, prior.covariance / correlation)

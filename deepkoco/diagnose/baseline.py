"""Baseline: the system as given, or as healthy logs have taught it, with the priors of its own parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.residuals.residuals import MAX_CHI2_SD, white_limit
from deepkoco.diagnose.run_to_run import RunToRun
from deepkoco.fit.data.wander import Wander
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.gauges import Gauge, scale_gauges
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.effects import effects_of
from deepkoco.systems.effects.learned import is_weight

OPEN = 0.1  # relative standard deviation of a prior from which it leaves a scale open
FIXED = 1e-4  # and of one that fixes it


@dataclass(frozen=True)
class Healthy:
    """Healthy logs of the unit and their fit.

    Attributes:
        recordings: The logs.
        windows: Their windows, with the estimated noise.
        before: The baseline before it was learned from them.
        causes: Small effects, as causes of the catalogue, that were added for them.
        fit: Fit with these effects.
        tempering: Factor by which the prior of this fit is narrower, as a variance; see :meth:`counted`.
    """

    recordings: tuple[Recording, ...]
    windows: Windows
    before: Baseline
    causes: tuple[Cause, ...]
    fit: Fit
    tempering: float = 1.0

    def counted(self) -> tuple[Baseline, FitProblem]:
        """Return the baseline and the problem of the joint fit, with priors that count as much as the residuals do.

        The likelihood takes residuals as independent noise. A model error of a hundred noise variances that lasts for
        fifty samples makes five thousand logs of one: the prior would then count for nothing, and stick and slip leave
        many minima that only a prior tells apart.
        """
        prior = tempered(self.before.prior, self.tempering)
        start = replace(self.before, prior=prior, narrowing=self.tempering)
        return start, FitProblem(start.system, noisier(self.windows, 1.0, self.tempering))


class Near(NamedTuple):
    """What fits of some logs tell of further fits of the same recorder.

    Attributes:
        values: Parameters near those of the unit.
        wander: Noise of the commands; its windows do not count. None where the logs show none.
        step: Longest integration step of a machine [s] with which a fit has followed the logs; infinite where the usual
            one does.
        delays: Delays of all commands and of all speeds that were found beside these values; null ones are left out.
    """

    values: Mapping[str, float]
    wander: Wander | None
    step: float = math.inf
    delays: Mapping[str, float] | None = None


@dataclass
class LosingCommands:
    """Of which commands healthy logs lose some: asked of a command once other logs seem to lose some of it.

    Most logs lose none, and the search in the healthy ones may take as long as all of their fits.

    Attributes:
        search: Index of a command -> whether they lose some of it.
    """

    search: Callable[[int], bool]
    _known: dict[int, bool] = field(default_factory=dict)

    def __contains__(self, index: int) -> bool:
        if index not in self._known:
            self._known[index] = self.search(index)
        return self._known[index]

    @property
    def found(self) -> tuple[int, ...]:
        """Indices of the commands of which they are known to lose some."""
        return tuple(sorted(index for index, loses in self._known.items() if loses))


@dataclass(frozen=True)
class Baseline:
    """Model, prior and floor from which a diagnosis starts.

    Attributes:
        system: The base system with every effect of the registry, at its present values.
        values: Present value of every parameter, pushes included.
        prior: Prior over the parameters that every fit frees.
        floor: chi2 per sample of this unit when nothing is wrong.
        correlation: Samples per independent sample of the healthy residuals; 1 unless estimated from several logs.
        effects: Effects that were added from healthy logs.
        losing: Of which commands the healthy logs also lose some; None without such logs.
        gauges: Scale gauges that the logs leave open, each with a parameter that keeps its value as given.
        healthy: The healthy logs from which it was learned, if any.
        runs: Run-to-run variance of these logs; None for fewer than two.
        tempering: Factor by which its prior is narrower, as a variance, than it was declared; see
            :mod:`deepkoco.diagnose.tempered`.
        roughness: Times the tolerances of causes that any unit has; see :mod:`deepkoco.diagnose.weighed`.
        narrowing: Factor by which its prior is narrower, as a variance, so that it counts as much as the residuals do;
            the correlation is not part of it.
        early: Time by which the commands of its logs act before their rows [s]; see
            :mod:`deepkoco.diagnose.between_rows`.
        near: What earlier fits of the logs have told, from which the next ones begin; None for none. One that was
            learned from healthy logs keeps the step alone, or values of the logs to explain.
    """

    system: ExtendedSystem
    values: dict[str, float]
    prior: Prior
    floor: float = 1.0
    correlation: float = 1.0
    effects: tuple[str, ...] = ()
    losing: LosingCommands | None = None
    gauges: tuple[Gauge, ...] = ()
    healthy: Healthy | None = None
    runs: RunToRun | None = None
    tempering: float = 1.0
    roughness: float = 1.0
    narrowing: float = 1.0
    early: float = 0.0
    near: Near | None = None

    def begun(self) -> Baseline:
        """Return it at the values that earlier fits of its own parameters have led to."""
        near = {} if self.near is None else self.near.values
        return replace(self, values={**self.values, **{n: near[n] for n in self.prior.names if n in near}})

    @property
    def wander(self) -> Wander | None:
        """Noise that commands of its recorder are known to have; None where none is known."""
        if self.healthy is not None and self.healthy.windows.wander is not None:
            return self.healthy.windows.wander
        return None if self.near is None else self.near.wander

    @property
    def step(self) -> float:
        """Longest integration step [s] that is known to follow logs of its recorder; infinite where none is known."""
        return math.inf if self.near is None else self.near.step

    @property
    def least_deflation(self) -> float:
        """Smallest deflation on any log of this unit: floor times correlation."""
        return self.floor * self.correlation

    @property
    def narrowed(self) -> float:
        """Factor by which its prior is narrower, as a variance, than it was stated, so that it counts as residuals do.

        It is infinite beside several healthy logs: the fits of their mean do not keep what their own data tell.
        """
        return math.inf if self.runs is not None else self.correlation * self.tempering * self.narrowing

    def most_noise(self, windows: Windows, deviations: float = MAX_CHI2_SD) -> float:
        """chi2 per sample of a log above which it contains more than this unit leaves when nothing is wrong.

        Args:
            windows: The windows of the log.
            deviations: The limit in standard deviations of chi2 per sample.
        """
        known = math.inf if self.healthy is None else self.healthy.windows.samples
        apart = 0.0 if self.runs is None else self.runs.floor_variance
        return self.floor * white_limit(windows, self.correlation, deviations, known, apart)

    @property
    def healthy_lag_one(self) -> float:
        """Correlation of neighbouring residuals of this unit when nothing is wrong."""
        if self.healthy is None:
            return 0.0
        if self.runs is not None:
            return max(self.runs.lag_one, 0.0)
        return max(dispersion(self.healthy.fit, self.healthy.windows).lag_one, 0.0)


class BaselineError(ValueError):
    """A learned baseline does not belong to the system or the logs that are given with it."""


def check_learned(baseline: Baseline, system: System) -> None:
    """Check that a baseline was learned on this system.

    Args:
        baseline: The learned baseline.
        system: The system of the diagnosis.

    Raises:
        BaselineError: It was learned on another system, or on this system with other parameter values.
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
            f'the baseline was learned on a "{learned.name}" with other parameters than the diagnosis{what}; learn it '
            "on the same model"
        )


def catalogue_system(system: System) -> ExtendedSystem:
    """Return the system with every effect of the registry; added effects have their null values."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    return ExtendedSystem(base, tuple(effects_of(base)), {p.name: p.value for p in system.parameters})


def baseline_from(system: System, windows: Windows) -> Baseline:
    """Return the baseline of a diagnosis without healthy logs: declared parameters and priors of the system."""
    extended = catalogue_system(system)
    values = {p.name: p.value for p in extended.parameters}
    values |= {name: p.value for name, p in Push.declared(extended, windows).items()}
    # A change of a learned weight is not a cause with a name, so every fit frees it like the system's own parameters.
    own = [p for p in extended.parameters if "." not in p.name or (is_weight(p.name) and p.value != 0.0)]
    return Baseline(extended, values, Prior.of(own))


def with_gauges_fixed(start: Baseline, windows: Windows) -> Baseline:
    """Keep one parameter of each scale gauge at the value given, where its prior leaves the gauge open.

    A voltage and an angle give only ratios of a motor's torque constant, inertia and friction. With wide priors on all
    of them, every size that is estimated would be as uncertain as this common factor.

    Args:
        start: The baseline without healthy logs.
        windows: The windows that it will be fitted to.
    """
    declared = {p.name: p for p in start.system.parameters}
    sd = dict(zip(start.prior.names, np.sqrt(np.diag(start.prior.covariance)), strict=True))
    loose = [n for n, s in sd.items() if start.values[n] > 0.0 and s >= OPEN * start.values[n]]
    if len(loose) < 2 or len(windows) == 0:
        return start
    problem = FitProblem(start.system, windows)
    state, _ = problem.fit_states(start.values, windows.state)
    at_given = problem.fit([Trial("gauges", start.prior.names, start.prior, start.values, state)], 1)[0]
    if at_given.diverged:
        return start
    found = scale_gauges(at_given, [declared[n] for n in start.prior.names])
    gauges = tuple(g for g in found if g.fixed in loose)
    covariance = start.prior.covariance.copy()
    for gauge in gauges:
        i = start.prior.names.index(gauge.fixed)
        covariance[i, :] = covariance[:, i] = 0.0
        covariance[i, i] = (FIXED * start.values[gauge.fixed]) ** 2
    return replace(start, prior=replace(start.prior, covariance=covariance), gauges=gauges)


def prior_of_mean(start: Baseline) -> tuple[Baseline, dict[str, float]]:
    """Return a baseline with the prior of the mean of all logs, and the run-to-run standard deviations.

    Args:
        start: Baseline learned from several healthy logs; its prior is that of one further log.
    """
    assert start.healthy is not None
    prior, varies = start.prior, start.healthy.windows.varies
    shared = np.array([varies.get(n, 0.0) ** 2 for n in prior.names])
    mean = replace(prior, covariance=prior.covariance - np.diag(shared))
    return replace(start, prior=mean), dict(varies)


def noisier(windows: Windows, floor: float, correlation: float = 1.0) -> Windows:
    """Return windows with the noise variance times the floor, and the run-to-run variance over the correlation.

    :func:`tempered` scales the prior in the same way.
    """
    return replace(
        windows,
        noise=tuple(n.times(math.sqrt(floor)) for n in windows.noise),
        varies={n: sd / math.sqrt(correlation) for n, sd in windows.varies.items()},
        stamp_sd=tuple(math.sqrt(floor) * sd for sd in windows.stamp_sd),
        wander=None if windows.wander is None else windows.wander.times(math.sqrt(floor)),
    )


def counting_floor(start: Baseline, windows: Windows) -> tuple[Baseline, Windows]:
    """Return a baseline with a floor of 1, and windows whose noise is larger instead.

    The prior of a learned baseline was computed with the floor. A likelihood without the floor, or one that counts
    correlated model errors as independent, would weigh too much against this prior.

    Args:
        start: A baseline learned from healthy logs.
        windows: Windows with the noise of the sensors alone.
    """
    windows = noisier(windows, start.floor, start.correlation)
    return replace(start, floor=1.0, prior=tempered(start.prior, start.correlation)), windows


def tempered(prior: Prior, correlation: float) -> Prior:
    """Return the prior with its covariance divided by the correlation [samples per independent sample].

    The cost counts each sample in full, though only one in ``correlation`` samples is independent. The deflation of
    likelihood ratios and covariances later divides the whole cost by the same factor.
    """
    return replace(prior, covariance=prior.covariance / correlation)

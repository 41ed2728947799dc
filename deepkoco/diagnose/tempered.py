"""Refit where a simulation of many parameters is far from its log: sizes first, then priors that count as the data do.

The likelihood takes residuals as independent noise. A model error of ten times the noise, which lasts for twenty
samples, makes two thousand of one: each combination of parameters that imitates a little of this error then outweighs
its prior, and a link of 0.1 kg becomes one of 1 kg. Scores are divided by this factor (the deflation of
:func:`.dispersion`) after the fit. Here the prior is multiplied by it before, which is the same likelihood. A parameter
that is far from its value as given even so has a prior as wide as its distance, like the parameter of a cause.

A few windows in which something else happens (the arm touches a table) count less: see :mod:`..fit.solve.robust`.

What the log still tells less of than the prior needs no slopes: such parameters keep their values as given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.baseline_refit import FEW_WINDOWS, few_windows, first_refit, refit_sharply
from deepkoco.diagnose.causes.units import LARGE_MISFIT
from deepkoco.diagnose.late_commands import LATE, common_delay, sizes_when_late, with_delay_free
from deepkoco.diagnose.one_controller import with_surplus_as_damping
from deepkoco.diagnose.one_make import covariance_of, groups_of
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.residual_noise import with_sharp_noise
from deepkoco.fit.solve.robust import under, undoubted, with_doubt
from deepkoco.fit.solve.scale_search import search_scales
from deepkoco.fit.solve.scaled_inverse import DivergedError

FAR_OFF = (
    0.5  # cost that other sizes leave, as a share, below which the values as given are no start of a fit
)
LOOSE = 0.2  # relative standard deviation of a prior from which another size of a parameter is tried
STAGES = 4  # of fits, each with the model error that the one before left
ITERATIONS = 8  # of each stage
# Information of the log about one parameter alone, as a share of its prior's, below which it keeps its value as given:
# if it is off by a standard deviation of its prior, the cost rises by this much, where a cause needs 24 to be named.
TOLD = 0.1


def refit_to_windows(start: Baseline, windows: Windows) -> tuple[Baseline, Windows, Fit]:
    """Refit a baseline to windows.

    Args:
        start: The baseline, as given or as learned from healthy logs.
        windows: The windows.

    Returns:
        The baseline with the prior that was used, the windows with the noise of the residuals, and the refit.
    """
    # Healthy logs of the unit show its sizes, and their model error is part of the prior.
    if start.healthy is not None or len(start.prior.names) + windows.state.shape[1] < MANY:
        return start, *refit_sharply(start, windows)
    usual = windows.steps
    try:
        windows, first = first_refit(start, windows)
    except DivergedError:
        first = None
    few = windows.take(few_windows(windows, len(start.prior.names)))
    # Where the values as given lead to the log, other sizes are not asked for.
    if first is None or first.chi2 > LARGE_MISFIT * few.samples:
        found = _from_other_sizes(start, windows)
        if found is not None:
            return found
    return start, *refit_sharply(start, windows, first, usual)


def tempered_to(
    declared: Baseline, names: tuple[str, ...], fit: Fit, windows: Windows, settled: bool = True
) -> Baseline:
    """Return a baseline whose prior counts as much as a fit's residuals let the data count.

    Args:
        declared: The baseline with its prior as declared.
        names: Parameters that it frees.
        fit: A fit of them.
        windows: The windows of this fit.
        settled: Whether the fit was made under such a prior.
    """
    factor = dispersion(fit, windows).deflation
    centre = declared.prior.centre[[declared.prior.names.index(n) for n in names]]
    covariance = covariance_of(declared, names, fit.values, settled) / factor
    prior = replace(declared.prior, names=names, centre=centre, covariance=covariance)
    return replace(declared, prior=prior, tempering=factor)


def told(start: Baseline, fit: Fit) -> tuple[str, ...]:
    """Return the parameters of which a log tells more than a small share of what the prior does, by groups of one make.

    Args:
        start: The baseline, with a tempered prior.
        fit: A fit of its parameters.
    """
    variance = start.prior.covariance.diagonal()
    share = np.array([fit.information[k, k] for k in map(fit.free.index, start.prior.names)]) * variance
    known = share > TOLD
    for group in groups_of(start, start.prior.names):
        # What a log tells of one servo it tells of the others of its make.
        known[group] = known[group].any()
    return tuple(n for n, yes in zip(start.prior.names, known, strict=True) if yes)


def _from_other_sizes(declared: Baseline, windows: Windows) -> tuple[Baseline, Windows, Fit] | None:
    """Refit from sizes that a coarse search finds; None where the values as given are as good a start."""
    few = few_windows(windows, FEW_WINDOWS)
    some = windows.take(few)
    # With states that suit the values as given, these have the better chance.
    problem = FitProblem(declared.system, some)
    state, _ = problem.fit_states(declared.values, some.state)
    sizes, delay = sizes_of_joints(declared), common_delay(declared.system)
    values, left = search_scales(problem, sizes, declared.values, state)
    if delay is not None:
        late, less = sizes_when_late(problem, sizes, declared.values, state, delay)
        if less < LATE * left:
            values, left, declared = late, less, with_delay_free(declared, delay)
    if left > FAR_OFF:
        return None
    values = with_surplus_as_damping(declared, values)
    # A short window has fewer minima.
    halves = halved(some)
    short, names = FitProblem(declared.system, halves), declared.prior.names
    state, _ = short.fit_states(values, halves.state)
    fit = short.fit_one(Trial("sizes", (), Prior.empty(), values, state), 1)
    for stage in range(STAGES):
        doubted = with_doubt(halves, fit)
        fit, halves = under(doubted, fit, halves), doubted
        short = FitProblem(declared.system, halves)
        start = tempered_to(declared, names, fit, halves, stage > 0)
        fit = short.fit_one(_from(start, fit), ITERATIONS)
        names = told(tempered_to(declared, names, fit, halves), fit)
    start = tempered_to(declared, names, fit, halves)
    problem = FitProblem(declared.system, windows)
    guess = windows.state.clone()
    guess[torch.from_numpy(few)] = fit.state[::2]
    state, _ = problem.fit_states(fit.values, guess)
    windows = with_doubt(windows, problem.fit_one(Trial("sizes", (), Prior.empty(), fit.values, state), 1))
    problem = FitProblem(declared.system, windows)
    fit = problem.fit_one(_from(start, replace(fit, state=state)), 2 * ITERATIONS)
    if float(undoubted(windows, fit).square().sum()) / windows.samples <= LARGE_MISFIT:
        # Little is left that the parameters could imitate; the usual refit frees all of them.
        return None
    sharp = with_sharp_noise(windows, fit)
    fit = under(sharp, fit, windows)
    windows = with_doubt(sharp, fit)
    fit = under(windows, fit, sharp)
    problem = FitProblem(declared.system, windows)
    start = tempered_to(declared, names, fit, windows)
    return start, windows, problem.fit_one(_from(start, fit))


def sizes_of_joints(start: Baseline, names: Sequence[str] | None = None) -> dict[int, dict[str, str]]:
    """Return joint -> kind -> parameter of which another order of size is possible, by its place in brackets.

    Masses and inertias are known from drawings.

    Args:
        start: The baseline.
        names: Parameters to choose from; None takes those with a wide prior.
    """
    system, result = start.system, {}
    spread = np.sqrt(start.prior.covariance.diagonal())
    wide = [
        n
        for n, s in zip(start.prior.names, spread, strict=True)
        if s >= (1.0 - 1e-9) * LOOSE * abs(start.values[n]) and "kg" not in system.parameter(n).unit
    ]
    joints = {name: j for j, name in enumerate(system.joint_names)}
    if len(system.commands) == len(system.command_joints):
        joints |= {c.name: j for c, j in zip(system.commands, system.command_joints, strict=True)}
    for name in wide if names is None else names:
        kind, _, place = name.partition("(")
        if place[:-1] in joints:
            result.setdefault(joints[place[:-1]], {})[kind] = name
    return result


def _from(start: Baseline, fit: Fit) -> Trial:
    """Return a trial of a baseline's parameters that starts from a fit; what it does not free is as given."""
    names = start.prior.names
    values = {n: v if n in names or n not in start.values else start.values[n] for n, v in fit.values.items()}
    return Trial("refit", names, start.prior, values, fit.state, fit.nuisance)

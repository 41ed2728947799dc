"""Estimates under errors that are correlated in time, which an honest interval covers too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.evidence.priors import declared, prior_with
from deepkoco.diagnose.verdict.findings import covering
from deepkoco.fit.coloured import ColouredProblem, whitening
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion

SLOW = 2.0  # samples per independent sample from which errors are correlated
ITERATIONS = 60


def fit_under_colour(problem: FitProblem, start: Baseline, causes: Sequence[Cause], fit: Fit) -> Fit | None:
    """Return the fit of the same parameters under errors that are correlated as those of a fit are.

    If the simulation lacked nothing, least squares and generalised least squares would estimate the same parameters. A
    force that is missing makes them differ: it is integrated twice, so the former follow its slow errors, and the
    latter the accelerations. An example is friction that varies along a rail, where a log always accelerates at the
    same places: the former then take it for mass. No resampling of such a log shows this.

    Source: Hausman, Specification tests in econometrics, Econometrica 46(6), 1978.

    Args:
        problem: The windows.
        start: The baseline.
        causes: Causes that the fit contains.
        fit: The fit under independent errors.

    Returns:
        The fit; None where no more than noise is left, where errors are not correlated, and where the fit is one of
        many parameters or of doubted windows, whose weights the filter would not know.
    """
    windows = problem.windows
    if fit.chi2 <= start.most_noise(windows) * windows.samples or start.tempering > 1.0:
        return None
    if dispersion(fit, windows).correlation < SLOW or any(c.effect == "event" for c in causes):
        return None
    prior = prior_with(problem, start, causes, fit.values)
    if not set(fit.free) <= set(prior.names):
        return None
    trial = Trial("coloured", fit.free, prior, fit.values, fit.state, fit.nuisance)
    coloured = ColouredProblem(problem, whitening(problem, [fit]))
    if problem.keeps_slopes([trial]) or coloured.samples == 0:
        return None
    found = coloured.fit([trial], ITERATIONS)[0]
    return None if found.diverged else found


def over_colour(
    had: Mapping[str, Estimate], own: Mapping[str, Estimate], problem: FitProblem, coloured: Fit | None
) -> dict[str, Estimate]:
    """Return estimates whose intervals are as wide about those under correlated errors.

    Args:
        had: Estimates with their intervals so far.
        own: The same with the intervals of their own fit, under independent errors.
        problem: The windows; its system declares the bounds.
        coloured: Fit under correlated errors; None widens nothing.
    """
    if coloured is None:
        return dict(had)
    bounds = {p.name: p for p in declared(problem, tuple(had))}
    return {
        name: covering(e, own[name], coloured.values[name], bounds[name]) if name in coloured.free else e
        for name, e in had.items()
    }

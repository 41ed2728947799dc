"""When fits of causes from the values as given are worth their time."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.screening import StartPoint
from deepkoco.diagnose.evidence.second_round import (
    can_gain,
    explained_mostly,
    promising_there,
    usual_penalty,
    without_hopeless_slow,
)
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.systems import any_system
from tests.fit.identify_logs import rod_log

CAUSES = catalogue(any_system("rod_pendulum"))
COULOMB, VISCOUS = CAUSES["coulomb"], CAUSES["viscous"]


@pytest.fixture(scope="module")
def refit():
    """A refit whose residuals are independent noise of the size that is assumed."""
    system = any_system("rod_pendulum")
    windows = cut_data([rod_log(20.0, 20001)], (), system, 1.0).train
    start = baseline_from(system, windows)
    trial = Trial("refit", start.prior.names, start.prior, start.values)
    fit = FitProblem(start.system, windows).fit_one(trial)
    noise = torch.randn(fit.residual.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    noise *= windows.valid
    noise *= (windows.samples / noise.square().sum()).sqrt()
    return start, windows, replace(fit, residual=noise, chi2=float(windows.samples))


def asked(refit, promise: float, penalty: float = 20.0, wanted: float = 24.0) -> bool:
    start, windows, fit = refit
    fit = replace(fit, penalty=penalty)
    return can_gain(start, windows, fit, fit, [COULOMB], {COULOMB.name: promise}, wanted)


def test_small_promises_beside_noise_cannot_be_named(refit):
    assert not asked(refit, 5.0)


def test_a_large_promise_can_be_named(refit):
    assert asked(refit, 100.0)


def test_a_refit_that_left_its_prior_can_gain_its_penalty(refit):
    assert asked(refit, 5.0, penalty=1000.0)


def test_the_less_is_wanted_the_more_is_asked_for(refit):
    assert asked(refit, 15.0, wanted=-24.0)


def test_slopes_bound_nothing_where_more_than_noise_is_left(refit):
    start, windows, fit = refit
    more = replace(fit, chi2=2.0 * fit.chi2, residual=2.0**0.5 * fit.residual)
    assert can_gain(start, windows, more, more, [COULOMB], {COULOMB.name: 0.0}, 24.0)


def test_beside_a_fit_that_leaves_noise_near_its_prior_nothing_can_be_gained(refit):
    start, windows, fit = refit
    reference = replace(fit, chi2=2.0 * fit.chi2, residual=2.0**0.5 * fit.residual, penalty=300.0)
    promised = {COULOMB.name: 300.0}
    strained = replace(fit, penalty=100.0)
    assert not can_gain(start, windows, reference, replace(fit, penalty=1.0), [COULOMB], promised, 24.0)
    assert can_gain(start, windows, reference, strained, [COULOMB], promised, 24.0)


def test_the_more_parameters_a_log_tells_the_larger_is_a_usual_penalty(refit):
    """Penalties of a unit drawn from the prior, over many units, exceed the usual one in one of twenty cases."""
    _, _, fit = refit
    one = replace(fit, free=("a",), information=np.eye(1), covariance=np.eye(1))
    assert usual_penalty(one) == APART
    count, rng = 26, np.random.default_rng(0)
    root = rng.standard_normal((count, count))
    information = root @ np.diag(10.0 ** rng.uniform(-3.0, 3.0, count)) @ root.T
    covariance = np.linalg.inv(information + np.eye(count))
    many = replace(fit, free=tuple(map(str, range(count))), information=information, covariance=covariance)
    true = rng.standard_normal((4000, count))
    noise = rng.standard_normal((4000, count)) @ np.linalg.cholesky(information).T
    found = (true @ information + noise) @ covariance
    assert (np.square(found).sum(1) > usual_penalty(many)).mean() == pytest.approx(0.05, abs=0.02)
    nothing = replace(many, information=np.zeros((count, count)), covariance=np.eye(count))
    assert usual_penalty(nothing) == APART


def test_a_push_is_no_start_where_most_windows_are_not_explained_as_given(refit):
    _, windows, fit = refit
    shares = torch.ones(len(windows), 1, 1, dtype=torch.float64)
    shares[: len(windows) // 3] = 100.0
    assert explained_mostly(replace(fit, residual=shares * fit.residual), fit)
    shares[: 2 * len(windows) // 3] = 100.0
    assert not explained_mostly(replace(fit, residual=shares * fit.residual), fit)


def test_causes_that_promise_nothing_as_given_are_not_fitted_there():
    here = [StartPoint(COULOMB, {"a": 1.0}, 9.0), StartPoint(COULOMB, {"a": 2.0}, 12.0)]
    here.append(StartPoint(VISCOUS, {}, 10.0))
    there = [StartPoint(COULOMB, {"a": 3.0}, 100.0)]
    found = promising_there(here, there)
    assert [(p.cause.name, p.values["a"]) for p in found] == [("coulomb", 2.0), ("coulomb", 3.0)]


def test_a_start_that_is_best_at_both_points_is_fitted_once():
    point = StartPoint(COULOMB, {"a": 1.0}, 9.0)
    assert len(promising_there([point], [point._replace(promise=50.0)])) == 1


def test_a_slow_effect_is_fitted_only_where_it_leads():
    charge = {COULOMB.name: 1.0, VISCOUS.name: 1.0}
    points = [StartPoint(COULOMB, {}, 100.0), StartPoint(VISCOUS, {}, 50.0)]
    assert without_hopeless_slow(points, {VISCOUS.effect}, charge) == points[:1]
    assert without_hopeless_slow(points, {COULOMB.effect}, charge) == points

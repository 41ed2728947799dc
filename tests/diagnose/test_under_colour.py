"""Intervals that cover the estimates under correlated errors, where a force is left that no model has."""

from dataclasses import replace

import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.verdict.under_colour import fit_under_colour, over_colour
from deepkoco.fit import Noise, cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from tests.oracle.slide import Car, Unit, log_of

MASS = 92.8
CAUSES = [catalogue(Car())["coulomb"]]


def fitted(ripple: float):
    """Problem, baseline and fit with dry friction of a car with a force along its rail [N]."""
    log = log_of(Unit(MASS, 200.0, 19.7, ripple=ripple), 43_012, 18.0)
    windows = cut_windows([log], Car(), 1.5, (Noise(1e-5, 0.01),), cover=True)
    start = baseline_from(Car(), windows)
    problem = FitProblem(start.system, windows)
    values = {**start.values, "coulomb.torque": 15.0}
    prior = prior_with(problem, start, CAUSES, values)
    return problem, start, problem.fit([Trial("fit", prior.names, prior, values)], 60)[0]


@pytest.fixture(scope="module")
def left_over():
    return fitted(2.0)


def test_where_a_force_is_left_the_mass_under_correlated_errors_is_another_and_nearer(left_over):
    problem, start, fit = left_over
    found = fit_under_colour(problem, start, CAUSES, fit)
    assert found is not None
    assert found.free == fit.free
    assert abs(found.values["mass"] - MASS) < 0.5 * abs(fit.values["mass"] - MASS)


def test_nothing_is_fitted_again_where_only_noise_is_left():
    problem, start, fit = fitted(0.0)
    assert fit_under_colour(problem, start, CAUSES, fit) is None


def test_nothing_is_fitted_again_under_a_tempered_prior_or_with_a_push(left_over):
    problem, start, fit = left_over
    assert fit_under_colour(problem, replace(start, tempering=9.0), CAUSES, fit) is None
    assert fit_under_colour(problem, start, [*CAUSES, catalogue(Car())["event"]], fit) is None


def test_an_interval_is_as_wide_about_both_estimates_and_keeps_the_value(left_over):
    problem, _, fit = left_over
    coloured = replace(fit, values={**fit.values, "mass": 97.0})
    own = {"mass": Estimate(94.0, 93.0, 95.0, "kg")}
    classes = {"mass": Estimate(94.0, 92.0, 96.5, "kg")}
    found = over_colour(classes, own, problem, coloured)["mass"]
    # Its own fit knows it to 1 kg: 97 + 1 above; below, what the classes say.
    assert (found.value, found.low, found.high) == (94.0, 92.0, pytest.approx(98.0))
    assert over_colour(classes, own, problem, None) == classes


def test_an_interval_stays_within_the_bounds_of_its_parameter(left_over):
    problem, _, fit = left_over
    coloured = replace(fit, values={**fit.values, "viscous": 1.0})
    own = {"viscous": Estimate(5.0, 2.0, 8.0, "N s/m")}
    assert over_colour(own, own, problem, coloured)["viscous"].low == 0.0

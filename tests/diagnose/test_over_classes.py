"""Intervals that cover every member of the classes of the named causes."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.residuals.residuals import Dispersion
from deepkoco.diagnose.verdict.findings import over_classes
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from tests.oracle.slide import Car, Unit, log_of

NAMES = ("mass", "viscous")


@pytest.fixture(scope="module")
def problem():
    windows = cut_windows([log_of(Unit(110.0, 180.0, 15.0), 20_200, 9.0)], Car(), 1.5)
    return FitProblem(baseline_from(Car(), windows).system, windows)


def candidate(problem, name: str, mass: float, sd: float) -> Candidate:
    """A cause and a fit with a given mass; the covariance is that of an invented fit."""
    cause = catalogue(Car())[name]
    start = baseline_from(Car(), problem.windows)
    blank = problem.fit([Trial(name, (), start.prior, start.values)], 1)[0]
    free = (*NAMES, *cause.free)
    fit = replace(
        blank, free=free, values={**blank.values, "mass": mass}, covariance=sd**2 * np.eye(len(free))
    )
    return Candidate(cause, fit, 1.0, 1.0)


def ranking(problem, *candidates: Candidate) -> Ranking:
    start = baseline_from(Car(), problem.windows)
    reference = problem.fit([Trial("refit", (), start.prior, start.values)], 1)[0]
    return Ranking(reference, candidates, Dispersion(1.0, 1.0, 0.0), 4.0, 100.0)


def test_an_interval_covers_the_estimates_beside_all_members_of_a_class_and_no_other(problem):
    offset, asymmetry, gain = (
        candidate(problem, name, mass, 1.0)
        for name, mass in (("torque_bias", 94.0), ("asymmetry", 90.0), ("gain", 60.0))
    )
    steps = [(ranking(problem, offset, asymmetry, gain), ("torque_bias", "asymmetry"))]
    own = {"mass": Estimate(94.0, 93.0, 95.0, "kg")}
    found = over_classes(own, problem, [offset.cause], steps)["mass"]
    # 1 kg below the smallest estimate of the class, and 1 kg above the largest.
    assert (found.value, found.low, found.high) == (94.0, pytest.approx(89.0), pytest.approx(95.0))


def test_a_member_that_was_fitted_without_another_named_cause_widens_nothing(problem):
    offset, asymmetry, coulomb = (
        candidate(problem, name, mass, 1.0)
        for name, mass in (("torque_bias", 94.0), ("asymmetry", 90.0), ("coulomb", 94.0))
    )
    steps = [
        (ranking(problem, offset, asymmetry), ("torque_bias", "asymmetry")),
        (ranking(problem, coulomb), ("coulomb",)),
    ]
    own = {"mass": Estimate(94.0, 93.0, 95.0, "kg")}
    assert over_classes(own, problem, [offset.cause, coulomb.cause], steps) == own


def test_the_parameters_of_a_cause_are_not_widened_by_its_own_class(problem):
    offset, asymmetry = (
        candidate(problem, name, mass, 1.0) for name, mass in (("torque_bias", 94.0), ("asymmetry", 90.0))
    )
    steps = [(ranking(problem, offset, asymmetry), ("torque_bias", "asymmetry"))]
    own = {"torque_bias.effort": Estimate(3.2, 3.1, 3.3, "N")}
    assert over_classes(own, problem, [offset.cause], steps, but=0) == own

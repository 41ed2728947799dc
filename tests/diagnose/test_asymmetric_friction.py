"""Viscous friction that differs between directions: told from a bias and from an uneven motor, and drawn as it is."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.residuals.friction_curve import friction_curve, pushes
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from tests.oracle.slide import Car, Unit, log_of
from tests.studied import studied

RIVALS = ["asymmetric_viscous", "torque_bias", "asymmetry", "spring"]
UNEVEN = {  # what a unit has -> the name
    "asymmetric_viscous": {"uneven": 50.0},
    "torque_bias": {"offset": 2.5},
    "asymmetry": {"asymmetry": 0.06},
}


@pytest.mark.parametrize("name", studied(UNEVEN, ("asymmetric_viscous", "torque_bias")))
def test_what_differs_between_directions_is_told_by_how_it_grows(name):
    log = log_of(Unit(110.0, 180.0, 0.0, **UNEVEN[name]), 20_400, 12.0)
    result = diagnose([log], Car(), only=RIVALS, window=1.5)
    assert result.names == (name,)
    if name == "asymmetric_viscous":
        found = result.causes[0].parameters["asymmetric_viscous.difference"]
        assert found.value == pytest.approx(50.0, rel=0.01)


@pytest.fixture(scope="module")
def problem():
    windows = cut_windows([log_of(Unit(110.0, 180.0, 15.0), 20_200, 9.0)], Car(), 1.5)
    return FitProblem(baseline_from(Car(), windows).system, windows)


def curve(problem, difference: float):
    """Friction curve up to 0.1 m/s of a car with 200 N s/m on average and this difference of its directions."""
    start = baseline_from(Car(), problem.windows)
    own = ("viscous", "asymmetric_viscous.difference")
    values = {**start.values, **dict(zip(own, (200.0, difference), strict=True))}
    blank = problem.fit([Trial("", (), start.prior, values)], 1)[0]
    fit = replace(blank, free=own, values=values, covariance=np.diag([1.0, 4.0]))
    return friction_curve(problem.system, fit, 0, 0.1, 1.0)


def test_the_friction_curve_has_another_slope_in_each_direction(problem):
    # 200 + 50/2 forward and 200 - 50/2 backward.
    found = curve(problem, 50.0)
    assert found.load[-1] == pytest.approx(22.5)
    assert found.load[0] == pytest.approx(-17.5)
    assert found.load[len(found.load) // 2] == pytest.approx(0.0, abs=1e-9)
    # Variances add: 1 + 4/4 (N s/m)^2 at 0.1 m/s.
    assert found.high[-1] - found.low[-1] == pytest.approx(2 * 1.96 * 0.1 * 2.0**0.5, rel=0.15)


@pytest.mark.parametrize(("difference", "drives"), [(300.0, False), (500.0, True), (-500.0, True)])
def test_friction_that_is_below_zero_in_one_direction_drives_the_joint(problem, difference, drives):
    assert pushes(curve(problem, difference)) == drives

"""Intervals of sizes that the data tell only up to a scale: how well that scale is known counts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.verdict.open_scales import scale_covariance, scale_variance
from deepkoco.fit.solve.gauges import Gauge
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import make_system
from deepkoco.systems.parameter import Parameter
from tests.diagnose.test_heavier_load import ASKED, go1_like, logs_of

# A pendulum whose torque constant of 2 is known to 10 %, its weight of 3 to 20 %, both scale together.
KNOWN = {
    "constant": Parameter("constant", 2.0, "N m/A", 0.1, 9.0, 0.2, ""),
    "weight": Parameter("weight", 3.0, "N m", 0.1, 9.0, 0.6, ""),
}
GAUGE = Gauge(
    "constant", {"constant": 1.0, "weight": 1.0}, "weight", "hold the joint with a lever on a scale"
)


def start_with(variance: float) -> SimpleNamespace:
    """A baseline that keeps the constant."""
    prior = Prior(("constant", "weight"), np.array([2.0, 3.0]), np.diag([variance, 0.36]))
    system = SimpleNamespace(parameter=KNOWN.__getitem__)
    return SimpleNamespace(
        gauges=(GAUGE,), system=system, prior=prior, values={"constant": 2.0, "weight": 3.0}
    )


def fit_with(variance: float) -> SimpleNamespace:
    """A fit of the constant c, of a load of 0.25 c, and of a delay that has no scale."""
    load = 0.25**2 * variance + 1e-10
    covariance = np.array([[variance, 0.25 * variance, 0.0], [0.25 * variance, load, 0.0], [0.0, 0.0, 1e-6]])
    return SimpleNamespace(free=("constant", "load", "delay"), covariance=covariance)


def test_scale_is_known_from_all_that_is_declared_of_its_members():
    # 1 / (0.1^-2 + 0.2^-2) = 0.008 as a relative variance
    assert scale_covariance(start_with(1e-8)) == pytest.approx(np.array([[0.008]]))


def test_what_follows_the_scale_is_as_uncertain_and_a_time_is_not():
    added = scale_variance(start_with(1e-8), fit_with(1e-8))
    # The load is 0.25 c with c = 2, so 0.25^2 * 2^2 * 0.008.
    assert added["load"] == pytest.approx(0.002)
    assert added["constant"] == pytest.approx(0.032)
    assert added["delay"] == 0.0


def test_a_kept_parameter_that_a_fit_frees_counts_by_itself():
    assert scale_variance(start_with(1e-8), fit_with(1e-3)) == {}


def test_without_a_gauge_nothing_is_added():
    start = start_with(1e-8)
    start.gauges = ()
    assert scale_variance(start, fit_with(1e-8)) == {}


@pytest.mark.study
@pytest.mark.long
def test_the_interval_of_a_load_holds_it_though_the_stiffness_is_off():
    unit = replace(go1_like(), stiffness=10.8)
    log, healthy = logs_of(unit, 2.0, "sin_time_square")
    found = diagnose([log], make_system("servo_pendulum"), healthy=healthy, only=ASKED)
    mass = found.causes[0].parameters["payload.mass"]
    assert mass.low < unit.mass < mass.high
    assert mass.high - mass.low < unit.mass

"""Which causes are worth a fit, and which of them one with all parameters."""

from dataclasses import replace

import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.footholds import LED, NEAR_BEST, leading
from deepkoco.diagnose.evidence.promising import within_reach
from deepkoco.diagnose.evidence.screening import StartPoint
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
CAUSES = catalogue(SYSTEM)
COULOMB, VISCOUS = CAUSES["coulomb"], CAUSES["viscous"]


@pytest.fixture(scope="module")
def fit():
    windows = cut_windows([hidden_log("rod_pendulum", {}, "chirp", 3, 4.0)], SYSTEM, 1.0)
    start = baseline_from(SYSTEM, windows)
    return FitProblem(start.system, windows).evaluate(start.values)


def fits(fit, costs):
    return [replace(fit, name=name, chi2=cost, penalty=0.0) for name, cost in costs]


def test_the_causes_that_explain_most_lead(fit):
    costs = [(str(k), 100.0 * 2.0**k) for k in range(LED + 4)]
    assert leading(fits(fit, costs), LED, NEAR_BEST) == {str(k) for k in range(LED)}


def test_all_causes_near_the_best_one_lead(fit):
    costs = [(str(k), 100.0 + k) for k in range(3 * LED)] + [("far", 1e4)]
    assert leading(fits(fit, costs), LED, NEAR_BEST) == {str(k) for k in range(3 * LED)}


def test_a_cause_counts_by_its_best_start(fit):
    costs = [("a", 1e9), ("b", 10.0), ("a", 1.0), ("c", 100.0), ("diverged", float("inf"))]
    assert leading(fits(fit, costs), 2) == {"a", "b"}
    assert leading([], 2) == set()


def test_causes_that_slopes_keep_far_from_a_name_are_not_fitted():
    event = next(c for c in CAUSES.values() if c.searched)
    charge = {c.name: 10.0 for c in (COULOMB, VISCOUS, event)}
    points = [StartPoint(COULOMB, {}, 20.0), StartPoint(VISCOUS, {}, 15.0), StartPoint(event, {}, 1.0)]
    assert within_reach(points, charge, 24.0) == [points[0], points[2]]
    assert within_reach([], charge, 24.0) == []

"""Starts around the optimum of a fit whose cost has many small minima."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.around import AROUND, around, lowest_around, trial_at
from deepkoco.diagnose.evidence.ranking import Candidate
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
CAUSE = catalogue(SYSTEM)["coulomb"]


@pytest.fixture(scope="module")
def rubbing():
    """A log with dry friction, and a candidate that stopped on its way to it."""
    log = hidden_log("rod_pendulum", {"coulomb": {"torque": 0.15}}, "chirp", 3, 8.0)
    windows = cut_windows([log], SYSTEM, 1.0)
    start = baseline_from(SYSTEM, windows)
    problem = FitProblem(start.system, windows)
    null = problem.evaluate(start.values)
    first = trial_at(problem, start, (), Candidate(CAUSE, null, 0.0, 0.0))
    early, late = (problem.fit([first], steps)[0] for steps in (2, 60))
    assert early.cost > late.cost + 10.0
    return start, problem, Candidate(CAUSE, early, 300.0, 140.0), Candidate(CAUSE, late, 400.0, 190.0)


@pytest.mark.parametrize("many", [False, True])
def test_the_lowest_minimum_around_is_kept_and_the_score_follows_it(rubbing, many, monkeypatch):
    # Fits of many parameters race, and all of them can end after the first iterations.
    monkeypatch.setattr(FitProblem, "keeps_slopes", lambda *_: many)
    start, problem, early, late = rubbing
    start = replace(start, floor=1e-3)  # so that whatever is left is more than this unit leaves
    found = lowest_around(problem, start, (), early, 2.0)
    won = early.fit.cost - found.fit.cost
    assert found.fit.cost == pytest.approx(late.fit.cost, abs=1.0)
    assert found.likelihood_ratio == pytest.approx(300.0 + won)
    assert found.delta_bic == pytest.approx(140.0 + won / 2.0)
    assert found.fit.values["coulomb.torque"] == pytest.approx(0.15, rel=0.1)


def test_a_fit_that_leaves_no_more_than_the_unit_is_not_tried_again(rubbing):
    start, problem, early, _ = rubbing
    assert lowest_around(problem, replace(start, floor=1e9), (), early, 2.0) is early


def test_starts_are_as_far_off_as_the_estimates_are_uncertain_and_within_bounds(rubbing):
    start, problem, _, late = rubbing
    trial = trial_at(problem, start, (), late)
    trials = around(problem, trial, late.fit, 4.0)
    assert len(trials) == 1 + AROUND
    assert trials[0] is trial
    names = list(late.fit.free)
    moved = np.array([[t.values[n] - trial.values[n] for n in names] for t in trials[1:]])
    sd = 2.0 * np.sqrt(late.fit.covariance.diagonal())
    assert (np.abs(moved) <= 4.0 * sd).all()
    assert (np.abs(moved).max(0) > 0.2 * sd).all()
    again = around(problem, trial, late.fit, 4.0)
    assert [t.values for t in again] == [t.values for t in trials]
    for t in around(problem, trial, late.fit, 1e12):
        for n in names:
            declared = problem.system.parameter(n)
            assert declared.low <= t.values[n] <= declared.high

"""Refits that start where candidates ended."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.crossed import better_reference, crossed, gains_elsewhere
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.fit.data.windows import cut_windows, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
KNOWN = catalogue(SYSTEM)


@pytest.fixture(scope="module")
def ranked():
    """Logs that differ in friction: a refit that has not found how, and candidates without any effect that have."""
    logs = [
        hidden_log("rod_pendulum", {"viscous": {"change": change}}, drive, 9, 5.0)
        for change, drive in ((0.01, "chirp"), (0.05, "steps"), (0.03, "chirp"))
    ]
    windows = replace(cut_windows(logs, SYSTEM, window_length(SYSTEM)), varies={"viscous": 0.03})
    start = baseline_from(SYSTEM, windows)
    problem = FitProblem(start.system, windows)
    prior = prior_with(problem, start, (), start.values)
    refit = Trial("refit", prior.names, prior, start.values)
    reference, settled = problem.fit([refit], 1)[0], problem.fit([refit], 60, 1e-9)[0]
    assert reference.cost > 1.01 * settled.cost
    assert float(settled.nuisance.abs().max()) > 0.005
    named = [KNOWN["coulomb"], KNOWN["dead_zone"]]
    candidates = tuple(
        SimpleNamespace(cause=cause, fit=replace(settled, name=cause.name), delta_bic=30.0) for cause in named
    )
    ranking = SimpleNamespace(
        candidates=candidates,
        best=candidates[0],
        reference=reference,
        dispersion=SimpleNamespace(correlation=1.0),
    )
    return problem, start, ranking, settled


def test_a_refit_starts_from_what_the_candidate_knows_of_each_log(ranked, monkeypatch):
    problem, start, ranking, settled = ranked
    tried = []
    fit = FitProblem.fit
    monkeypatch.setattr(FitProblem, "fit", lambda self, t, *a, **k: tried.extend(t) or fit(self, t, *a, **k))
    found = better_reference(problem, start, (), ranking)
    assert found is not None
    assert found.cost == pytest.approx(settled.cost, rel=1e-6)
    assert len(tried) == 2
    for trial in tried:
        np.testing.assert_array_equal(trial.nuisance, settled.nuisance)


def test_candidates_start_from_what_another_one_knows_of_each_log(ranked, monkeypatch):
    problem, start, ranking, settled = ranked
    tried = []
    monkeypatch.setattr(
        "deepkoco.diagnose.evidence.crossed.fit_best", lambda _, trials, __: tried.extend(trials) or {}
    )
    assert crossed(problem, start, (), ranking) == {}
    assert len(tried) == 2
    for trial in tried:
        np.testing.assert_array_equal(trial.nuisance, settled.nuisance)


def test_a_cause_that_only_found_a_better_minimum_gains_elsewhere(ranked):
    problem, start, ranking, settled = ranked
    best = _fitted(problem, start, ranking.reference, settled)
    assert best.likelihood_ratio > 100.0
    assert gains_elsewhere(start, SimpleNamespace(candidates=(best,), best=best, reference=ranking.reference))


def test_a_cause_that_is_there_gains_by_itself():
    log = hidden_log("rod_pendulum", {"coulomb": {"torque": 0.02}}, "chirp", 9, 8.0)
    windows = cut_windows([log], SYSTEM, window_length(SYSTEM))
    start = baseline_from(SYSTEM, windows)
    problem = FitProblem(start.system, windows)
    prior = prior_with(problem, start, (), start.values)
    reference = problem.fit([Trial("refit", prior.names, prior, start.values)], 60)[0]
    best = _fitted(problem, start, reference, reference)
    assert best.likelihood_ratio > 100.0
    assert not gains_elsewhere(start, SimpleNamespace(candidates=(best,), best=best, reference=reference))


def _fitted(problem, start, reference, foot):
    """Dry friction, fitted from a point, as a candidate over a reference."""
    cause = KNOWN["coulomb"]
    values = {**foot.values, cause.free[0]: 1e-4}
    fit = problem.fit([trial_of(problem, start, (), cause, values, foot.state, foot)], 60)[0]
    return SimpleNamespace(cause=cause, fit=fit, likelihood_ratio=reference.cost - fit.cost)

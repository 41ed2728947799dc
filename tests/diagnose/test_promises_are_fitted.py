"""No cause leads a ranking by its promise: what was crowded out by larger promises is fitted where these gain less."""

import pytest

import deepkoco.diagnose.evidence.selection as selection
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.ranking import ranked
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import make_system
from experiments.studies.diagnosis.hidden.recorded import unit_log

NAMES = ("coulomb", "viscous", "gain", "backlash")


@pytest.fixture(scope="module")
def refitted():
    """A pendulum with dry friction: the problem, the baseline, its refit and what causes choose starts from."""
    system = make_system("rod_pendulum")
    log = unit_log("rod_pendulum", {"coulomb": {"torque": 0.3}}, "steps", 5, 10.0)
    windows = cut_windows([log], system, window_length(system))
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    problem = FitProblem(start.system, windows)
    chi2 = reference.chi2 / windows.samples
    hints = Hints(start.system, windows, missing_torque(problem, reference), chi2)
    return problem, start, reference, hints


@pytest.mark.parametrize("inflated", [n for n in NAMES if n != "coulomb"])
def test_a_cause_that_promises_too_much_does_not_keep_the_others_from_a_fit(refitted, monkeypatch, inflated):
    problem, start, reference, hints = refitted
    known = catalogue(problem.system.base)
    screen = selection.screen

    def too_much(*given):
        return [
            p._replace(promise=p.promise * (1e6 if p.cause.name == inflated else 1.0)) for p in screen(*given)
        ]

    monkeypatch.setattr(selection, "screen", too_much)
    found = selection.rank(problem, start, reference, (), hints, [known[n] for n in NAMES])
    assert found.best.cause.name == "coulomb"
    assert found.best.likelihood_ratio == pytest.approx(reference.cost - found.best.fit.cost)
    assert found.best.fit.values["coulomb.torque"] == pytest.approx(0.3, rel=0.1)


def test_a_cause_that_was_not_fitted_is_ranked_behind_the_best_that_was(refitted):
    problem, start, reference, _ = refitted
    known = catalogue(problem.system.base)
    trial = selection.trial_of(
        problem, start, (), known["viscous"], dict(reference.values), reference.state, reference
    )
    fits = {"viscous": problem.fit([trial])[0]}
    promises = {"coulomb": 1e9, "viscous": 1.0}
    found = ranked(problem, start, reference, [known[n] for n in ("coulomb", "viscous")], fits, promises)
    assert [c.cause.name for c in found.candidates] == ["viscous", "coulomb"]
    assert found.candidates[1].delta_bic == found.candidates[0].delta_bic


def test_a_simple_friction_that_promises_little_is_fitted_beside_one_of_more_parameters(
    refitted, monkeypatch
):
    # Its slope in a refit without it promised little of what it explains, and a falling friction was named.
    problem, start, reference, hints = refitted
    known = catalogue(problem.system.base)
    screen = selection.screen

    def too_little(*given):
        return [
            p._replace(promise=p.promise * (1e-4 if p.cause.name == "coulomb" else 1.0))
            for p in screen(*given)
        ]

    monkeypatch.setattr(selection, "screen", too_little)
    found = selection.rank(problem, start, reference, (), hints, [known[n] for n in ("stribeck", "coulomb")])
    assert found.best.cause.name == "coulomb"
    assert found.best.fit.values["coulomb.torque"] == pytest.approx(0.3, rel=0.1)

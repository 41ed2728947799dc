"""A cause that others make superfluous is taken out again; causes that are there stay."""

import numpy as np
import pytest

from deepkoco.diagnose.baseline import refit_sharply, start_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.elimination import BENDING, PUSHES, carried, eliminated, without_kinds
from deepkoco.diagnose.forward import Selected, Selection
from deepkoco.diagnose.residuals import missing_torque
from deepkoco.diagnose.selection import FURTHER, prior_with, rank
from deepkoco.identify.fit import FitProblem, Trial
from deepkoco.identify.windows import cut_windows, moving, window_length
from deepkoco.systems import make_system
from experiments.hidden.unit import hidden_log


def test_only_the_cause_that_is_not_there_goes():
    hidden = {"asymmetry": {"share": 0.03}, "lag": {"time_constant": 0.01}}
    system = make_system("rod_pendulum")
    windows = cut_windows(
        [hidden_log("rod_pendulum", hidden, "steps", 221, 20.0)], system, window_length(system)
    )
    windows = windows.take(moving(windows))
    start = start_from(system, windows)
    windows, reference = refit_sharply(start, windows)
    problem = FitProblem(start.system, windows)
    known = catalogue(system)
    accepted = [known["torque_bias"], known["lag"], known["asymmetry"]]
    prior = prior_with(problem, start, accepted, start.values)
    fit = problem.fit([Trial("all", prior.names, prior, reference.values, reference.state, reference.zero)])[
        0
    ]
    kept, less = eliminated(problem, start, accepted, fit, FURTHER)
    assert [c.name for c in kept] == ["lag", "asymmetry"]
    assert less.values["torque_bias.effort"] == 0.0
    assert "torque_bias.effort" not in less.free
    assert abs(less.values["lag.time_constant"] - 0.01) < 0.001
    # Both that are there stay, whatever order they were found in.
    assert len(eliminated(problem, start, kept[::-1], less, FURTHER)[0]) == 2
    # However much is wanted, so many stay, and the strongest of them; wherever in the list the others stood.
    assert [c.name for c in eliminated(problem, start, accepted, fit, 1e9)[0]] == ["asymmetry"]
    assert [c.name for c in eliminated(problem, start, accepted[::-1], fit, 1e9)[0]] == ["asymmetry"]
    assert len(eliminated(problem, start, accepted, fit, 1e9, least=2)[0]) == 2
    assert eliminated(problem, start, accepted, fit, 1e9, least=0)[0] == []


def fitted(log, names):
    """Windows, baseline, causes, and the fit with all of these."""
    system = make_system("rod_pendulum")
    windows = cut_windows([log], system, window_length(system))
    windows = windows.take(moving(windows))
    start = start_from(system, windows)
    windows, reference = refit_sharply(start, windows)
    problem, known = FitProblem(start.system, windows), catalogue(system)
    causes = [known[n] for n in names]
    prior = prior_with(problem, start, causes, start.values)
    fit = problem.fit([Trial("all", prior.names, prior, reference.values, reference.state, reference.zero)])
    return problem, start, causes, fit[0], reference


def test_what_only_keeps_the_baseline_in_its_prior_is_not_judged_by_windows():
    """A longer rod is mended as well by other masses and weights, which were known to one percent."""
    log = hidden_log(
        "rod_pendulum", {"length": {"factor": 1.05}, "gain_drift": {"rate": 0.004}}, "steps", 224
    )
    problem, start, causes, fit, _ = fitted(log, ["length", "gain_drift"])
    half = np.arange(len(problem.windows)) % 3 == 0
    kept, same = carried(problem, start, causes, fit, problem.windows.take(half), 0)
    assert [c.name for c in kept] == ["length", "gain_drift"]
    assert same is fit


def test_detents_and_tones_go_where_others_stay():
    problem, start, causes, fit, _ = fitted(
        hidden_log("rod_pendulum", {"coulomb": {"torque": 0.1}}, "steps", 225, 12.0),
        ["cogging", "coulomb", "periodic"],
    )
    kept, less = without_kinds(problem, start, causes, fit, BENDING)
    assert [c.name for c in kept] == ["coulomb"]
    assert not any(n.startswith(("cogging", "periodic")) for n in less.free)
    assert less.values["cogging.sine"] == less.values["periodic.sine"] == 0.0
    # Alone they stay, for the verdict to judge.
    alone, unchanged = without_kinds(problem, start, causes[:1], fit, BENDING)
    assert alone == causes[:1]
    assert unchanged is fit
    # So does everything where nothing of these kinds is there.
    same, unchanged = without_kinds(problem, start, causes, fit, PUSHES)
    assert (same, unchanged) == (causes, fit)


def test_what_does_better_beside_the_others_takes_a_place():
    hidden = {"coulomb": {"torque": 0.1}, "gain": {"factor": 1.1}}
    problem, start, wrong, fit, reference = fitted(
        hidden_log("rod_pendulum", hidden, "steps", 226, 20.0), ["viscous", "gain"]
    )
    known = catalogue(start.system.base)
    selection = Selection(
        start, problem.windows, None, [known[n] for n in ("viscous", "coulomb", "gain")], 24.0
    )
    ranking = rank(
        problem,
        start,
        reference,
        (),
        selection._hints(problem, reference, missing_torque(problem, reference)),
    )
    found = Selected(fit, tuple(wrong), ((ranking, ("viscous",)), (ranking, ("gain",))), problem)
    better = selection._reconsidered(found)
    assert [c.name for c in better.accepted] == ["coulomb", "gain"]
    assert better.final.cost < fit.cost - 100.0
    assert better.steps[0][1] == ("coulomb",)
    assert better.final.values["coulomb.torque"] == pytest.approx(0.1, rel=0.1)

"""Backward elimination: superfluous causes are removed and true causes stay."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.elimination import (
    BENDING,
    PUSHES,
    _squared_size,
    carried,
    eliminated,
    without_kinds,
)
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.reconsider import reconsidered
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.evidence.selection import FURTHER, rank
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log


def test_eliminated_removes_only_the_false_cause():
    hidden = {"asymmetry": {"share": 0.03}, "lag": {"time_constant": 0.01}}
    system = make_system("rod_pendulum")
    windows = cut_windows(
        [hidden_log("rod_pendulum", hidden, "steps", 221, 20.0)], system, window_length(system)
    )
    windows = windows.take(moving(windows))
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows)
    problem = FitProblem(start.system, windows)
    known = catalogue(system)
    accepted = [known["torque_bias"], known["lag"], known["asymmetry"]]
    prior = prior_with(problem, start, accepted, start.values)
    fit = problem.fit(
        [Trial("all", prior.names, prior, reference.values, reference.state, reference.nuisance)]
    )[0]
    kept, less = eliminated(problem, start, accepted, fit, FURTHER)
    assert [c.name for c in kept] == ["lag", "asymmetry"]
    assert less.values["torque_bias.effort"] == 0.0
    assert "torque_bias.effort" not in less.free
    assert abs(less.values["lag.time_constant"] - 0.01) < 0.001
    # Both that are there stay, whatever order they were found in.
    assert len(eliminated(problem, start, kept[::-1], less, FURTHER)[0]) == 2
    # Their estimates say so much of both that no fit without one is made, unless a share of the whole is asked for.
    made: dict = {}
    assert eliminated(problem, start, kept, less, FURTHER, done=made)[0] == kept
    assert made == {}
    eliminated(problem, start, kept, less, FURTHER, share=1e-9, done=made)
    assert len(made) == 2
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
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows)
    problem, known = FitProblem(start.system, windows), catalogue(system)
    causes = [known[n] for n in names]
    prior = prior_with(problem, start, causes, start.values)
    fit = problem.fit(
        [Trial("all", prior.names, prior, reference.values, reference.state, reference.nuisance)]
    )
    return problem, start, causes, fit[0], reference


def test_carried_does_not_test_causes_that_mostly_save_prior_penalty():
    """Changed masses, known to one percent, can replace a longer rod; only the prior counts against them."""
    log = hidden_log(
        "rod_pendulum", {"length": {"factor": 1.05}, "gain_drift": {"rate": 0.004}}, "steps", 224
    )
    problem, start, causes, fit, _ = fitted(log, ["length", "gain_drift"])
    half = np.arange(len(problem.windows)) % 3 == 0
    kept, same = carried(problem, start, causes, fit, problem.windows.take(half), 0)
    assert [c.name for c in kept] == ["length", "gain_drift"]
    assert same is fit


def test_a_parameter_far_from_what_is_declared_stays_beside_an_effect_that_any_unit_has():
    """A constant load of which any unit has as much explains more of chi2 than a longer rod costs the prior."""
    hidden = {"length": {"factor": 1.05}, "torque_bias": {"effort": 0.2}}
    problem, start, causes, fit, reference = fitted(
        hidden_log("rod_pendulum", hidden, "steps", 224, 12.0), ["length", "torque_bias"]
    )
    most = {"share": 0.1, "before": reference.cost, "done": {}}
    assert eliminated(problem, start, causes, fit, FURTHER, exempt=causes[1:], **most)[0] == causes
    # Beside an effect that is named, it could be left by a form of it that is not exactly so.
    assert eliminated(problem, start, causes, fit, FURTHER, **most)[0] == causes[1:]


def test_without_kinds_removes_detents_and_tones_beside_other_causes():
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


def test_a_cause_stays_without_which_the_others_let_the_simulation_diverge():
    problem, start, causes, fit, _ = fitted(
        hidden_log("rod_pendulum", {"coulomb": {"torque": 0.1}}, "steps", 225, 12.0),
        ["cogging", "quadratic"],
    )
    feeding = replace(fit, values=fit.values | {"quadratic.drag": -1e3})
    kept, unchanged = without_kinds(problem, start, causes, feeding, BENDING)
    assert (kept, unchanged) == (causes, feeding)


def looked_at_again(system, hidden, excitation, seed, first, wrong, known):
    """Select two causes, the second of them wrong, and compare each again with the other in the model."""
    system = make_system(system)
    log = hidden_log(system.name, hidden, excitation, seed, 20.0)
    windows = cut_windows([log], system, window_length(system))
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    problem, catalogued = FitProblem(start.system, windows), catalogue(system)
    selection = Selection(start, windows, None, [catalogued[n] for n in known], 24.0)
    steps, accepted, fit = [], [], reference
    for name in (first, wrong):
        hints = selection.hints(problem, fit, missing_torque(problem, fit))
        ranking = rank(problem, start, fit, accepted, hints, [catalogued[name]])
        steps.append((ranking, (name,)))
        accepted.append(ranking.best.cause)
        fit = ranking.best.fit
    return fit, reconsidered(selection, Selected(fit, tuple(accepted), tuple(steps), problem))


@pytest.mark.study
@pytest.mark.parametrize(
    ("system", "hidden", "first", "wrong", "right"),
    [
        (
            "rod_pendulum",
            {"coulomb": {"torque": 0.1}, "gain": {"factor": 1.1}},
            "gain",
            "viscous",
            "coulomb",
        ),
        (
            "rod_pendulum",
            {"coulomb": {"torque": 0.1}, "event": {"torque": 1.0, "start": 7.3, "duration": 0.2}},
            "event",
            "viscous",
            "coulomb",
        ),
        (
            "two_link_arm",
            {"coulomb(joint 2)": {"torque": 0.2}, "gain(joint 1)": {"factor": 1.15}},
            "gain(joint 1)",
            "viscous(joint 2)",
            "coulomb(joint 2)",
        ),
    ],
)
def test_reconsidered_replaces_a_cause_by_one_that_fits_better_with_the_others(
    system, hidden, first, wrong, right
):
    known = ("viscous(joint 1)", "coulomb(joint 1)") if system == "two_link_arm" else ()
    fit, better = looked_at_again(system, hidden, "steps", 226, first, wrong, (first, wrong, right, *known))
    # The right one may take either place, and the other one the place that is left.
    assert {c.name for c in better.accepted} == {first, right}
    assert better.final.cost < fit.cost - 100.0
    assert [members for _, members in better.steps] == [(c.name,) for c in better.accepted]
    torque = hidden[right]["torque"]
    assert better.final.values[f"{right}.torque"] == pytest.approx(torque, rel=0.1)
    if first == "event":
        assert better.final.values["event.start"] == pytest.approx(7.3, abs=0.02)


def test_pruned_ranks_the_last_cause_again_without_those_that_are_removed():
    log = hidden_log("rod_pendulum", {"coulomb": {"torque": 0.1}}, "steps", 225, 8.0)
    problem, start, causes, fit, reference = fitted(log, ["coulomb", "cogging"])
    selection = Selection(start, problem.windows, None, causes, 24.0)
    hints = selection.hints(problem, reference, missing_torque(problem, reference))
    first = rank(problem, start, reference, (), hints, causes)
    steps = [(first, ("coulomb", "cogging")), (first, ())]
    found = selection._pruned(Selected(fit, tuple(causes), tuple(steps), problem))
    assert found.accepted == (causes[0],)
    ((ranking, members),) = found.steps
    # Beside a detent, the friction was compared with everything but the detent.
    assert {c.cause.name for c in ranking.candidates} == {"coulomb", "cogging"}
    assert members == ("coulomb",)
    assert not any(n.startswith("cogging") for n in ranking.reference.free)
    assert found.final is ranking.best.fit


def test_a_changed_parameter_or_a_limit_is_never_plain_by_its_estimate():
    system = make_system("rod_pendulum")
    log = hidden_log("rod_pendulum", {"lag": {"time_constant": 0.01}}, "steps", 221, 10.0)
    windows = cut_windows([log], system, window_length(system))
    start = baseline_from(system, windows.take(moving(windows)))
    problem = FitProblem(start.system, windows.take(moving(windows)))
    known = catalogue(system)
    sizes = {}
    for name in ("lag", "saturation", next(n for n in known if n.startswith("changed("))):
        cause = known[name]
        prior = prior_with(problem, start, [cause], start.values)
        away = {n: start.values[n] * 0.5 + 0.01 for n in cause.free}
        trial = Trial(name, prior.names, prior, {**start.values, **away})
        sizes[name] = _squared_size(problem, start, cause, problem.fit([trial], 1)[0])
    assert sizes.pop("lag") > 1e3
    assert set(sizes.values()) == {0.0}

"""Tolerance: a cause is not named where the log shows no more of it than any healthy machine has."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.causes.tolerance import CLOCK_RATE, LOAD_SHARE, MOVING_SHARE, SHARE_OF_USUAL
from deepkoco.diagnose.causes.tolerance import Healthy as Machine
from deepkoco.diagnose.evidence import classes, refine_ranking
from deepkoco.diagnose.evidence.classes import APART, width
from deepkoco.diagnose.evidence.minor import sample_period, tolerated, usual_speed
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.evidence.refine_ranking import classed
from deepkoco.diagnose.residuals.residuals import SLOTS, Dispersion, white_limit
from deepkoco.diagnose.verdict.minor_causes import minor_causes
from deepkoco.fit import FitProblem, cut_windows
from deepkoco.systems import ExtendedSystem, make_system
from tests.oracle.unit import hidden_log

BASE = make_system("rod_pendulum")
KNOWN = catalogue(BASE)
LOAD = BASE.load_scales[0]


@pytest.fixture(scope="module")
def stage():
    """Windows, their baseline, and its simulation with given values of a cause's parameters."""
    windows = cut_windows([hidden_log("rod_pendulum", {}, "steps", 20001, 6.0)], BASE, 1.6)
    start = baseline_from(BASE, windows)
    problem = FitProblem(start.system, windows)
    at_rest = problem.evaluate(start.values)

    def fitted(values, sd):
        free = tuple(values)
        return replace(
            at_rest, values={**at_rest.values, **values}, free=free, covariance=np.diag([sd**2] * len(free))
        )

    return problem, start, fitted


@settings(max_examples=60, deadline=None)
@given(
    share=st.floats(-3.0, 3.0),
    sd=st.floats(1e-4, 1.0),
    name=st.sampled_from(["coulomb", "clock_skew", "gain", "actuation_delay", "payload"]),
)
def test_cause_is_tolerated_if_its_whole_interval_lies_within_its_tolerance(stage, name, share, sd):
    problem, start, fitted = stage
    cause = KNOWN[name]
    (size,) = cause.sizes
    declared, period = start.system.parameter(size), sample_period(problem.windows)
    most = cause.tolerance(Machine(declared, LOAD, period, {}))
    fit = fitted({size: start.values[size] + share * most}, sd * most)
    ends = abs(share) + 1.96 * sd
    if abs(ends - 1.0) > 1e-6:
        assert tolerated(problem, start, cause, fit, 1.0) == (ends < 1.0)


def test_tolerances_are_those_of_a_healthy_machine(stage):
    problem, start, _ = stage
    period = sample_period(problem.windows)
    assert period == pytest.approx(0.01, rel=0.02)

    def most(name, parameter, values=()):
        declared = start.system.parameter(parameter)
        return KNOWN[name].tolerance(Machine(declared, LOAD, period, dict(values)))

    assert most("coulomb", "coulomb.torque") == pytest.approx(LOAD_SHARE * LOAD)
    assert most("clock_skew", "clock_skew.rate") == CLOCK_RATE
    assert most("actuation_delay", "actuation_delay.delay") == pytest.approx(1e-4, rel=0.02)
    # A push of 0.1 s may be ten times as strong as a load that acts for a second.
    long, short = (
        KNOWN["event"].tolerance(Machine(start.system.parameters[0], LOAD, period, {"event.duration": d}))
        for d in (1.0, 0.1)
    )
    assert (long, short) == pytest.approx((LOAD_SHARE * LOAD, 10.0 * LOAD_SHARE * LOAD))


@pytest.mark.parametrize(
    ("name", "parameter", "power"),
    [
        ("viscous", "viscous.change", 1),
        ("asymmetric_viscous", "asymmetric_viscous.difference", 1),
        ("quadratic", "quadratic.drag", 2),
    ],
)
def test_a_friction_that_grows_with_the_speed_is_tolerated_by_its_load_on_a_fast_joint(
    name, parameter, power
):
    system = ExtendedSystem(BASE, (name,), {})
    declared = system.parameter(parameter)
    slow, unknown, fast = (
        KNOWN[name].tolerance(Machine(declared, LOAD, 0.01, {}, v)) for v in (1.0, 0.0, 60.0)
    )
    assert slow == unknown == pytest.approx(SHARE_OF_USUAL * declared.prior_sd)
    # The wheel meets at its speed no more than that share of its load.
    assert fast * 60.0**power == pytest.approx(MOVING_SHARE * LOAD)


def test_the_speed_of_a_joint_is_that_of_its_windows(stage):
    _, start, _ = stage
    state = torch.tensor([[0.0, 3.0], [5.0, -4.0]], dtype=torch.float64)
    for name in ("viscous", "clock_skew"):
        assert usual_speed(start, KNOWN[name], state) == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize(
    ("share", "tolerated_then"),
    [(1.0, True), (0.5, True), (0.0, True), (-0.5, False), (1.5, False)],
    ids=["as learned", "half", "none", "reversed", "more"],
)
def test_less_of_an_effect_than_the_healthy_logs_show_is_no_fault(stage, share, tolerated_then):
    # Healthy logs showed a drift of 0.3 % a second, as an imitation of something else perhaps.
    problem, start, fitted = stage
    name, drift = "gain_drift.rate", 3e-3
    system = ExtendedSystem(start.system.base, tuple(e.name for e in start.system.effects), {name: drift})
    learned = replace(start, system=system, values={**start.values, name: drift})
    fit = fitted({name: share * drift}, 1e-5)
    found = tolerated(FitProblem(system, problem.windows), learned, KNOWN["gain_drift"], fit, 1.0)
    assert found == tolerated_then


def test_an_effect_a_little_beyond_null_by_chance_is_no_fault(stage):
    problem, start, fitted = stage
    learned = replace(start, values={**start.values, "gain_drift.rate": 3e-3})
    fit = fitted({"gain_drift.rate": -2.8e-5}, 1.3e-5)
    assert tolerated(problem, learned, KNOWN["gain_drift"], fit, 1.0)
    assert not tolerated(problem, start, KNOWN["gain_drift"], fit, 1.0)
    # And a learned value that is nothing itself, of either sign, allows nothing.
    for nothing in (1e-9, -1e-9):
        hardly = replace(start, values={**start.values, "gain_drift.rate": nothing})
        assert not tolerated(problem, hardly, KNOWN["gain_drift"], fit, 1.0)


def test_cause_without_a_size_is_never_tolerated(stage):
    problem, start, fitted = stage
    assert KNOWN["unit_slip"].free == ()
    assert not tolerated(problem, start, KNOWN["unit_slip"], fitted({}, 1.0), 1.0)


def test_shape_parameters_are_no_sizes():
    assert KNOWN["stribeck"].sizes == ("stribeck.coulomb", "stribeck.breakaway")
    assert KNOWN["spring"].sizes == ("spring.stiffness",)
    assert KNOWN["event"].sizes == ("event.torque",)


def ranking_of(stage, chi2, ratios, samples=1000.0):
    """A ranking of causes with these likelihood ratios whose best leaves this chi2 per sample."""
    problem, _, fitted = stage
    fit = fitted({}, 1.0)
    left = replace(fit, chi2=chi2 * problem.windows.samples)
    candidates = tuple(Candidate(KNOWN[n], left, r, r) for n, r in ratios.items())
    return Ranking(fit, candidates, Dispersion(chi2, 1.0, 0.0), 1.0, samples)


def test_width_of_a_class_grows_with_the_model_error_that_is_left(stage):
    problem, start, _ = stage
    limit = white_limit(problem.windows)
    widths = [width(problem, start, ranking_of(stage, chi2, {"coulomb": 1.0})) for chi2 in (1.0, limit)]
    assert widths == [APART, APART]
    # With 1,000 independent samples of a model error of mean square 3, of which one window shows SLOTS values.
    wide = width(problem, start, ranking_of(stage, limit + 3.0, {"coulomb": 1.0}))
    assert wide == pytest.approx(APART * (1.0 + 3.0 * 1000.0 / SLOTS) / 4.0)
    # More windows do not average the model error out.
    longer = width(problem, start, ranking_of(stage, limit + 3.0, {"coulomb": 1.0}, 2000.0))
    assert longer / wide == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize(
    ("chi2", "coulomb", "first"),
    [(5.0, 990.0, "coulomb"), (1.0, 990.0, "stribeck"), (5.0, 900.0, "stribeck")],
)
def test_simpler_cause_leads_where_model_error_hides_what_the_other_adds(stage, chi2, coulomb, first):
    problem, start, _ = stage
    ranking = ranking_of(stage, chi2, {"stribeck": 1000.0, "coulomb": coulomb})
    # No candidate is within reach of the class, so no fit is needed.
    candidates = [replace(c, delta_bic=100.0 * c.delta_bic) for c in ranking.candidates]
    found, members = classed(problem, start, replace(ranking, candidates=tuple(candidates)), ())
    assert found.best.cause.name == members[0] == first


@pytest.mark.parametrize(
    ("harm", "chi2", "first"),
    [(0.0, 5.0, "coulomb"), (5.0, 5.0, "stribeck"), (0.0, 1.0, "stribeck"), (None, 5.0, "stribeck")],
)
def test_simpler_form_of_a_friction_leads_its_class_unless_held_out_windows_show_harm(
    stage, monkeypatch, harm, chi2, first
):
    problem, start, _ = stage
    # Gain is simpler, too, but no friction.
    ranking = ranking_of(stage, chi2, {"stribeck": 1000.0, "gain": 970.0, "coulomb": 965.0})
    scores = {"stribeck": 200.0, "gain": 196.0, "coulomb": 195.0}
    fits = {n: replace(ranking.best.fit, name=n) for n in scores}
    candidates = [
        replace(c, fit=fits[c.cause.name], delta_bic=scores[c.cause.name]) for c in ranking.candidates
    ]
    monkeypatch.setattr(classes, "expected_gaps", lambda *given: [0.0] * len(given[3]))
    errors = {"stribeck": np.array([9.0, 11.0]), "coulomb": np.array([9.5, 10.5]) + (harm or 0.0)}
    monkeypatch.setattr(refine_ranking, "held_out_chi2", lambda *given: errors[given[2].name])
    held = None if harm is None else problem.windows
    found, members = classed(problem, start, replace(ranking, candidates=tuple(candidates)), (), held)
    assert found.best.cause.name == members[0] == first
    assert set(members) == set(scores)


@pytest.mark.parametrize(
    ("behind", "first"), [(0.5 * APART, "coulomb"), (1.5 * APART, "stribeck")], ids=["alike", "told apart"]
)
def test_a_shape_that_noise_may_have_made_does_not_lead_its_simpler_form(stage, behind, first):
    problem, start, _ = stage
    # A gain is as simple and explains as much, but it is no form of friction.
    ranking = ranking_of(stage, 1.0, {"stribeck": 1000.0, "gain": 998.0, "coulomb": 997.0})
    scores = {"stribeck": 200.0, "gain": 200.0 - 0.9 * behind, "coulomb": 200.0 - behind}
    candidates = [replace(c, delta_bic=scores[c.cause.name]) for c in ranking.candidates]
    found, members = classed(problem, start, replace(ranking, candidates=tuple(candidates)), ())
    assert found.best.cause.name == members[0] == first


def test_only_candidates_that_may_belong_to_a_class_are_fitted_to_its_winner(stage, monkeypatch):
    problem, start, _ = stage
    ranking = ranking_of(
        stage, 1.0, {"coulomb": 100.0, "gain": 97.0, "viscous": 92.0, "stribeck": 91.0, "lag": 70.0}
    )
    asked = []

    def expected(problem, start, winner, others, accepted):
        asked.extend(c.cause.name for c in others)
        return [1.0] * len(others)

    monkeypatch.setattr(classes, "expected_gaps", expected)
    members = classes.equivalent(problem, start, ranking)
    # The gain is in anyway; Stribeck's parameters cost more than a class is wide; a lag is behind by more than chance.
    assert asked == ["viscous"]
    assert members == ("coulomb", "gain", "viscous")


def test_minor_causes_say_why_they_are_not_named(stage):
    from deepkoco.diagnose.evidence.minor import Minor
    from deepkoco.diagnose.evidence.selected import Selected

    problem, _, fitted = stage
    fit = fitted({"clock_skew.rate": 1e-6}, 1e-7)
    step = (None, ("coulomb",))
    minor = (Minor(KNOWN["clock_skew"], fit, None, 1.0), Minor(KNOWN["clock_skew"], fit, 0.004, 1.0))
    small, shape = minor_causes(Selected(fit, (KNOWN["coulomb"],), (step,), problem, minor=minor))
    assert "no larger than on any healthy machine" in small["text"]
    assert "0.4 %" in shape["text"]
    assert "the form of coulomb" in shape["text"]
    assert small["parameters"]["clock_skew.rate"]["value"] == 1e-6


def test_a_robot_of_a_model_file_has_more_of_every_effect_and_less_of_it_beside_healthy_logs(stage):
    problem, start, fitted = stage
    file = make_system("rod_pendulum")
    file.parameters = tuple(replace(p, guessed=True) for p in file.parameters)  # as of a file without priors
    names = tuple(e.name for e in start.system.effects)
    alone = replace(start, system=ExtendedSystem(file, names, {}))
    own = Healthy((), problem.windows, alone, (), problem.evaluate(start.values))
    beside = replace(alone, healthy=own)

    def allows(baseline, times):
        fit = fitted({"coulomb.torque": times * LOAD_SHARE * LOAD}, 1e-9)
        return tolerated(FitProblem(baseline.system, problem.windows), baseline, KNOWN["coulomb"], fit, 1.0)

    assert [allows(start, times) for times in (0.9, 1.1)] == [True, False]
    assert [allows(beside, times) for times in (2.9, 3.1)] == [True, False]
    assert [allows(alone, times) for times in (9.0, 11.0)] == [True, False]

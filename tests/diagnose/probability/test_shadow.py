"""Probabilities for logs of units with and without a hidden effect."""

import math
from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.probability import shadow
from deepkoco.diagnose.probability.columns import columns_at
from deepkoco.diagnose.probability.healthy_unit import learned_unit
from deepkoco.diagnose.probability.posterior import weighed, without_usual
from deepkoco.diagnose.probability.refine import refined, started
from deepkoco.diagnose.probability.shadow import linearised, probabilities
from deepkoco.fit import FitProblem, cut_windows, moving
from deepkoco.systems import make_system
from experiments.studies.diagnosis.hidden_cause.cases import draw_case
from tests.oracle.unit import hidden_log

SYSTEM = "rod_pendulum"
NAMES = ("coulomb", "viscous", "gain", "torque_bias", "payload", "actuation_delay", "quadratic", "asymmetry")
CAUSES = [catalogue(make_system(SYSTEM))[n] for n in NAMES]
BIAS = {"torque_bias": {"effort": 0.03}}


def fitted(log):
    base = make_system(SYSTEM)
    windows = cut_windows([log], base, 1.6)
    windows = windows.take(moving(windows))
    start = baseline_from(base, windows)
    windows, reference = refit_sharply(start, windows)
    return FitProblem(start.system, windows), reference, start


@pytest.fixture(scope="module")
def with_friction():
    return fitted(hidden_log(SYSTEM, {"coulomb": {"torque": 0.05}}, "steps", 20501, 12.0))


def test_the_hidden_cause_is_the_most_probable_one_and_its_size_is_known(with_friction):
    problem, reference, start = with_friction
    answer = probabilities(problem, reference, start, CAUSES)
    assert answer.of_cause("coulomb") > 0.9
    size = answer.explanations[0].parameters["coulomb"]["coulomb.torque"]
    assert size.low < 0.05 < size.high
    assert size.value == pytest.approx(0.05, rel=0.2)


def test_nothing_is_the_most_probable_answer_for_a_healthy_unit():
    problem, reference, start = fitted(hidden_log(SYSTEM, {}, "steps", 20502, 12.0))
    answer = probabilities(problem, reference, start, CAUSES)
    assert answer.nothing > 0.8


def test_what_a_healthy_log_shows_too_is_no_cause():
    problem, reference, start = fitted(hidden_log(SYSTEM, BIAS, "steps", 20503, 12.0))
    assert probabilities(problem, reference, start, CAUSES).of_cause("torque_bias") > 0.8
    healthy = hidden_log(SYSTEM, BIAS, "chirp", 20503, 12.0, take=1)
    windows = cut_windows([healthy], make_system(SYSTEM), 1.6)
    windows = windows.take(moving(windows))
    before = baseline_from(make_system(SYSTEM), windows)
    windows, fit = refit_sharply(before, windows)
    unit = learned_unit(Healthy((healthy,), windows, before, (), fit), CAUSES)
    assert probabilities(problem, reference, start, CAUSES, unit).nothing > 0.8


def test_a_column_is_the_slope_of_the_simulation(with_friction):
    problem, reference, start = with_friction
    point = linearised(problem, reference, start, CAUSES, None)
    coordinates = point.fixed.catalogue.coordinates
    k = next(k for k, c in enumerate(coordinates) if c.parameter == "gain.factor" and c.slope)
    column = columns_at(problem, reference, coordinates).changes[:, :, k]
    theta = np.array([[reference.values[n] for n in problem.names]] * 2)
    theta[:, problem.names.index("gain.factor")] += [1e-4, -1e-4]
    moved = problem.predict(
        theta, reference.state[None].repeat(2, 1, 1), reference.nuisance[None].repeat(2, 1)
    )
    slope = ((moved[0] - moved[1]) * problem.weight / 2e-4).reshape(column.shape).numpy()
    np.testing.assert_allclose(column, slope, rtol=1e-2, atol=1e-3 * np.abs(slope).max())


def test_refits_from_two_starts_end_at_one_stationary_point(with_friction):
    problem, reference, start = with_friction
    point = linearised(problem, reference, start, CAUSES, None)
    own = next(s for s in point.scored if s.explanation.causes == ("coulomb",))
    starts = [started(point.fixed, own.explanation, np.array([d]), own.amplitude) for d in (0.0, 0.1)]
    ends = refined(problem, point.fixed, starts)
    assert all(e.stationary for e in ends)
    assert ends[0].cost == pytest.approx(ends[1].cost, abs=0.2)
    assert ends[0].value[-1] == pytest.approx(ends[1].value[-1], rel=0.02)


def test_an_explanation_that_ends_in_another_minimum_is_refitted_from_nothing(with_friction, monkeypatch):
    problem, reference, start = with_friction
    point = linearised(problem, reference, start, CAUSES, None)
    chosen = [
        next(s for s in point.scored if s.explanation.causes == causes) for causes in ((), ("payload",))
    ]
    wanted, _ = shadow._refitted(problem, point, chosen)

    def stuck(problem, fixed, refits):
        # A simulation that is far from the log, taken for stationary.
        ends = refined(problem, fixed, refits)
        away = [replace(r, weights=r.weights + 1.0) if r.explanation.causes else r for r in ends]
        return away if refits[0].explanation == chosen[0].explanation else ends

    def weighed_with_weights(problem, fixed, refit, causes):
        found = weighed(problem, fixed, refit, causes)
        return replace(found, log_weight=found.log_weight - 100.0 * bool((refit.weights > 0.5).any()))

    monkeypatch.setattr(shadow, "refined", stuck)
    monkeypatch.setattr(shadow, "weighed", weighed_with_weights)
    found, plain = shadow._refitted(problem, point, chosen)
    assert plain is not None
    assert [f.causes for f in found] == [(), ("payload",)]
    assert found[1].log_weight == pytest.approx(wanted[1].log_weight, abs=0.2)


@pytest.fixture(scope="module")
def healthy_refits():
    problem, reference, start = fitted(hidden_log(SYSTEM, {}, "steps", 20502, 12.0))
    point = linearised(problem, reference, start, CAUSES, None)
    singles = {s.explanation.causes: s for s in reversed(point.scored) if len(s.explanation.items) <= 1}
    starts = [started(point.fixed, s.explanation, s.mode, s.amplitude) for s in singles.values()]
    refits = {r.explanation.causes: r for r in refined(problem, point.fixed, starts)}
    return problem, point, refits


@pytest.mark.parametrize("cause", ["torque_bias", "coulomb"])
def test_nothing_weighs_the_same_at_the_point_of_a_cause_that_frees_no_more_than_any_unit_has(
    healthy_refits, cause
):
    problem, point, refits = healthy_refits
    plain, freed = (weighed(problem, point.fixed, refits[c], point.causes) for c in ((), (cause,)))
    narrower = without_usual(problem, point.fixed, refits[cause,], point.causes)
    assert narrower is not None
    assert narrower.causes == ()
    assert narrower.log_weight == pytest.approx(plain.log_weight, abs=1.0)
    assert narrower.log_weight > freed.log_weight


def test_a_delay_of_a_share_of_a_millisecond_is_left_out_where_any_unit_has_as_much(healthy_refits):
    # A delay is no column of what any unit has: its start is away from null.
    problem, point, refits = healthy_refits
    refit = refits["actuation_delay",]
    assert without_usual(problem, point.fixed, refit, point.causes) is None
    fixed = replace(point.fixed, share=0.05)
    narrower = without_usual(problem, fixed, refit, point.causes)
    assert narrower is not None
    assert narrower.causes == ()
    assert narrower.log_weight > weighed(problem, fixed, refit, point.causes).log_weight


def test_what_is_more_than_any_unit_has_is_not_left_out(with_friction):
    problem, reference, start = with_friction
    point = linearised(problem, reference, start, CAUSES, None)
    own = next(s for s in point.scored if s.explanation.causes == ("coulomb",))
    (refit,) = refined(problem, point.fixed, [started(point.fixed, own.explanation, own.mode, own.amplitude)])
    assert without_usual(problem, point.fixed, refit, point.causes) is None


@pytest.mark.study
@pytest.mark.long
def test_a_lag_of_a_millisecond_is_nothing_before_encoders_of_little_noise(tmp_path):
    # As a slope, at a point of 500 noise variances, it left "nothing" 3 nats behind the lag.
    handed = draw_case(50000, 21, 20.0).question(tmp_path).handed
    assert diagnose(list(handed.log), handed.system).verdict == "nothing"


@pytest.mark.study
@pytest.mark.long
def test_a_gain_beside_one_healthy_log_is_no_other_machine(tmp_path):
    # The first refit with a gain ended 64 nats below the machine without it, which it contains.
    handed = draw_case(38000, 8, 16.0).question(tmp_path).handed
    result = diagnose(list(handed.log), handed.system, healthy=list(handed.healthy))
    assert {"gain", "changed(gain(motor))"} & set(result.causes[0].members)


@pytest.mark.study
def test_the_report_has_the_answer_where_it_is_asked_for():
    log = hidden_log(SYSTEM, {"coulomb": {"torque": 0.05}}, "steps", 20501, 12.0)
    result = diagnose([log], SYSTEM, only=NAMES, evidence=True)
    told = result.to_json()["evidence"]
    assert told["causes"][0]["name"] == "coulomb"
    assert ["coulomb"] in told["credible_set"]
    assert math.isclose(sum(e["probability"] for e in told["explanations"]), 1.0, abs_tol=0.01)
    assert "evidence" not in diagnose([log], SYSTEM, only=NAMES).to_json()

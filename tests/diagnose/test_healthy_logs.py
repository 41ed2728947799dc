"""Causes that are consistent with healthy logs join the baseline; others are named."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose import BaselineError, diagnose
from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.causes.event import EVENT
from deepkoco.diagnose.evidence import forward
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.evidence.seen_when_healthy import (
    Hypothesis,
    consistent_with_healthy,
    healthy_shows_pushes,
)
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.healthy import extended, learn_baseline
from deepkoco.diagnose.residuals.residuals import dispersion, missing_torque
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.systems import ExtendedSystem, make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
LENGTH = window_length(SYSTEM)
SEED = 31  # of the unit; its excitations differ
BIAS = {"torque_bias": {"effort": 0.001}}


@pytest.fixture(scope="module")
def bent():
    """A baseline learned from a unit with a small offset that no search has looked for."""
    log = hidden_log("rod_pendulum", BIAS, "chirp", SEED, 12.0)
    windows = cut_windows([log], SYSTEM, LENGTH)
    start = baseline_from(SYSTEM, windows)
    return learn_baseline([log], SYSTEM, LENGTH), start


def claim(start, hidden, name):
    """One cause fitted to a log of a unit with something hidden."""
    windows = cut_windows([hidden_log("rod_pendulum", hidden, "steps", SEED, 20.0)], SYSTEM, LENGTH)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    problem, cause = FitProblem(start.system, windows), catalogue(SYSTEM)[name]
    prior = prior_with(problem, start, [cause], reference.values)
    trial = Trial(name, prior.names, prior, reference.values, reference.state, reference.nuisance)
    return problem, Hypothesis(cause, (), problem.fit([trial])[0])


@pytest.mark.study
def test_consistent_with_healthy_holds_for_effects_that_healthy_logs_show(bent):
    start, _ = bent
    assert start.effects == ()  # too small to be learned from this log alone
    problem, same = claim(start, BIAS, "torque_bias")
    assert consistent_with_healthy(start, problem, [same]) == [True]
    problem, more = claim(start, {"torque_bias": {"effort": 0.05}}, "torque_bias")
    assert consistent_with_healthy(start, problem, [more]) == [False]
    problem, other = claim(start, {"coulomb": {"torque": 0.05}}, "coulomb")
    assert consistent_with_healthy(start, problem, [other]) == [False]
    assert consistent_with_healthy(start, problem, []) == []


@pytest.mark.study
def test_consistent_with_healthy_is_false_without_healthy_logs(bent):
    start, plain = bent
    problem, same = claim(start, BIAS, "torque_bias")
    assert consistent_with_healthy(plain, problem, [same]) == [False]
    with pytest.raises(BaselineError, match="not learned from healthy logs"):
        extended(plain, [same.cause])


@pytest.mark.study
def test_extended_baseline_takes_the_estimate_of_its_healthy_logs(bent):
    start, _ = bent
    wider = extended(start, [catalogue(SYSTEM)["torque_bias"]])
    assert wider.effects == ("torque_bias",)
    index = wider.prior.names.index("torque_bias.effort")
    sd = np.sqrt(wider.prior.covariance[index, index])
    assert abs(wider.values["torque_bias.effort"] - 0.001) < 3.0 * sd
    assert 0.0 < sd < 0.005
    # It is in there once, however often it is added.
    again = extended(wider, [catalogue(SYSTEM)["torque_bias"]])
    assert again.prior.names == wider.prior.names


@pytest.mark.study
def test_diagnose_does_not_name_an_offset_that_healthy_logs_show(bent):
    start, _ = bent
    log = hidden_log("rod_pendulum", BIAS, "steps", SEED, 60.0)
    only = ["torque_bias", "coulomb"]
    assert diagnose([log], "rod_pendulum", only=only).names == ("torque_bias",)
    assert diagnose([log], "rod_pendulum", baseline=start, only=only).verdict == "nothing"


@pytest.mark.study
def test_learn_baseline_accepts_an_extended_model():
    """The effects of an earlier model.yaml are in the baseline; a new cause is named."""
    unit = {"coulomb": {"torque": 0.1}, "lag": {"time_constant": 0.02}}
    model = ExtendedSystem(SYSTEM, ("coulomb",), {"coulomb.torque": 0.08})
    healthy = hidden_log("rod_pendulum", unit, "chirp", SEED, 15.0)
    log = hidden_log("rod_pendulum", {**unit, "gain": {"factor": 0.85}}, "steps", SEED, 20.0)
    result = diagnose([log], model, [healthy], only=["gain", "viscous", "lag"])
    assert result.names == ("gain",)
    assert result.causes[0].parameters["gain.factor"].value == pytest.approx(0.85, rel=0.03)
    values = {p.name: p.value for p in result.model.parameters}
    assert values["coulomb.torque"] == pytest.approx(0.1, rel=0.1)
    assert values["lag.time_constant"] == pytest.approx(0.02, rel=0.1)


@pytest.mark.study
def test_learn_baseline_adds_all_causes_that_healthy_logs_cannot_distinguish():
    log = hidden_log("rod_pendulum", {"actuation_delay": {"delay": 0.004}}, "chirp", 34, 15.0)
    start = learn_baseline([log], SYSTEM, LENGTH)
    alike = {
        "actuation_delay": "delay",
        "sensing_delay": "delay",
        "lag": "time_constant",
        "low_pass": "time_constant",
    }
    found = [f"{name}.{alike[name]}" for name in start.effects if name in alike]
    assert len(found) >= 2
    assert sum(start.values[n] for n in found) == pytest.approx(0.004, rel=0.3)
    index = [start.prior.names.index(n) for n in found]
    covariance = start.prior.covariance[np.ix_(index, index)]
    # Their sum is known better than each.
    assert covariance.sum() < 0.5 * np.diag(covariance).min()


@pytest.mark.study
def test_selection_tests_lasting_causes_against_healthy_logs_with_all_others(bent, monkeypatch):
    start, _ = bent
    known = catalogue(SYSTEM)
    windows = cut_windows([hidden_log("rod_pendulum", {}, "steps", SEED, 12.0)], SYSTEM, LENGTH)
    problem = FitProblem(start.system, windows)
    null = problem.evaluate(start.values)
    names = ("coulomb", "viscous", "cogging", "event")
    free = tuple(n for name in names for n in known[name].free)
    fit = replace(null, free=free)
    accepted = tuple(known[n] for n in names)
    steps = []
    for cause in accepted:
        candidates = (Candidate(cause, fit, 50.0, 40.0), Candidate(known["gain"], null, 0.0, 0.0))
        ranking = Ranking(null, candidates, dispersion(null, windows), 1.0, 500.0)
        steps.append((ranking, (cause.name, "gain")))
    asked = []

    def listening(of, at, claims):
        asked.extend([of, at, *claims])
        return [claim.cause.name == "viscous" for claim in claims]

    monkeypatch.setattr(forward, "consistent_with_healthy", listening)
    selection = Selection(start, windows, None, None, 24.0)
    acting = FitProblem(start.system, windows)
    found = Selected(fit, accepted, tuple(steps), acting)
    assert [c.name for c in selection.consistent_with_healthy(found)] == ["viscous"]
    # The windows with the commands that acted; and what was never fitted makes no claim.
    assert asked[:2] == [start, acting]
    assert [(c.cause.name, [b.name for b in c.beside]) for c in asked[2:]] == [
        ("coulomb", ["viscous", "cogging", "event"]),
        ("viscous", ["coulomb", "cogging", "event"]),
    ]


def pushed(torque):
    """Windows of a log with a push of that torque, their refit and its problem."""
    hidden = {"event": {"torque": torque, "start": 4.3, "duration": 0.2}} if torque else {}
    windows = cut_windows([hidden_log("rod_pendulum", hidden, "steps", 20007, 8.0)], SYSTEM, LENGTH)
    start = baseline_from(SYSTEM, windows)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    return start, windows, reference


@pytest.mark.parametrize(("usual", "shown"), [(0.3, True), (0.0, False), (0.05, False)])
def test_a_push_is_usual_where_healthy_logs_show_one_nearly_as_strong(usual, shown):
    before, healthy, fit = pushed(usual)
    start = replace(before, healthy=Healthy((), healthy, before, (), fit))
    _, windows, reference = pushed(0.3)
    missing = missing_torque(FitProblem(start.system, windows), reference)
    assert healthy_shows_pushes(start, windows, missing, EVENT) == shown
    assert not healthy_shows_pushes(before, windows, missing, EVENT)

"""Small effects of healthy logs are learned only where they could be named for the other logs."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import counting_floor, noisier
from deepkoco.diagnose.baseline_refit import refit_counting_floor, refit_sharply
from deepkoco.diagnose.beside_healthy import BesideHealthy
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence import seen_when_healthy
from deepkoco.diagnose.evidence.minor import LEAST_SHARE
from deepkoco.diagnose.evidence.priors import freed, prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.evidence.seen_when_healthy import Hypothesis, consistent_with_healthy
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.healthy import is_of_any_machine, learn_as_simulated, learn_baseline
from deepkoco.diagnose.progress import silent
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
LENGTH = window_length(SYSTEM)
SEED = 63
DRY = {"coulomb": {"torque": 0.02}}  # of the unit, when nothing is wrong
HEAVY = {**DRY, "gain": {"factor": 0.6}}


@pytest.fixture(scope="module")
def healthy():
    """A log of the unit in which nothing is wrong."""
    return hidden_log("rod_pendulum", DRY, "chirp", SEED, 12.0)


@pytest.fixture(scope="module")
def plain(healthy):
    """What it tells of the unit before any small effect is learned."""
    return learn_baseline([healthy], SYSTEM, LENGTH, extension=0)


def beside(healthy, hidden):
    """Another log of the unit, beside its healthy one."""
    log = hidden_log("rod_pendulum", hidden, "steps", SEED, 12.0)
    data, causes = cut_data([log], [], SYSTEM, LENGTH), [*catalogue(SYSTEM).values()]
    return BesideHealthy(
        DiagnosisRequest([log], SYSTEM, data, LENGTH, 0, DETECTION, causes, silent, 0.0), [healthy]
    )


def test_logs_are_far_beyond_healthy_ones_where_they_leave_fifty_times_more(healthy, plain):
    far, near = beside(healthy, HEAVY), beside(healthy, DRY)
    assert far.are_far_beyond(plain)
    assert not near.are_far_beyond(plain)
    # The refit that has told so is that of the diagnosis.
    base = far.refit_of(replace(plain, losing=(0,)))
    left = base.reference.chi2 / base.train.samples
    left += base.reference.penalty / base.train.samples
    assert LEAST_SHARE * (left - 1.0) * plain.floor > plain.floor - 1.0 > 0.0
    assert base.start.losing == (0,)
    assert base.start.floor == 1.0
    # Of a baseline with another effect it is none, nor where no refit was needed to tell.
    assert far.refit_of(replace(plain, effects=("coulomb",))) is None
    assert near.refit_of(plain) is None


def test_learning_ends_where_it_is_enough(healthy):
    asked = []

    def enough(learned):
        asked.append(learned)
        return len(learned.effects) == 1

    learned = learn_as_simulated([healthy], SYSTEM, LENGTH, enough=enough)
    assert [len(a.effects) for a in asked] == [0, 1]
    assert len(learned.effects) >= 1  # with what the log does not tell from it
    # Each effect leaves less of the healthy log.
    assert asked[0].floor > asked[1].floor
    assert learn_as_simulated([healthy], SYSTEM, LENGTH, enough=lambda _: True).effects == ()


def test_a_refit_that_counts_the_floor_is_one_under_a_larger_noise(plain):
    windows = cut_windows([hidden_log("rod_pendulum", DRY, "steps", SEED, 12.0)], SYSTEM, LENGTH)
    windows = windows.take(moving(windows))
    start, counted, fit = refit_counting_floor(plain, windows)
    assert (start.floor, start.correlation) == (1.0, 1.0)
    # The noise of the sensors is the same as that of a refit without the floor, the rest is the floor.
    sharp, _ = refit_sharply(plain, windows)
    sds = np.array([n.sd for n in counted.noise]) / np.array([n.sd for n in sharp.noise])
    assert sds == pytest.approx(np.sqrt(plain.floor), rel=0.1)
    _, same = counting_floor(plain, sharp)
    problem = FitProblem(start.system, counted)
    assert same.steps == counted.steps
    # It is a minimum: a fit that begins there stays.
    again = problem.fit_one(Trial("refit", fit.free, start.prior, fit.values).from_fit(fit))
    assert again.cost == pytest.approx(fit.cost, rel=1e-3)
    assert fit.cost / counted.samples < 3.0


def test_a_cause_that_the_healthy_log_plainly_denies_needs_no_further_fits(plain, monkeypatch):
    windows = cut_windows([hidden_log("rod_pendulum", HEAVY, "steps", SEED, 12.0)], SYSTEM, LENGTH)
    windows, reference = refit_sharply(plain, windows.take(moving(windows)))
    problem, gain = FitProblem(plain.system, windows), catalogue(SYSTEM)["gain"]
    prior = prior_with(problem, plain, [gain], reference.values)
    trial = Trial("gain", prior.names, prior, {**reference.values, "gain.factor": 0.6}, reference.state)
    claim = Hypothesis(gain, (), problem.fit([trial], 60)[0])
    assert seen_when_healthy.compared(plain, problem, plain.healthy, [claim]) == [False]
    compared = []
    monkeypatch.setattr(seen_when_healthy, "compared", lambda *a: compared.append(a))
    assert consistent_with_healthy(plain, problem, [claim]) == [False]
    assert compared == []


def test_a_healthy_log_that_says_nothing_of_a_cause_does_not_deny_it(plain, monkeypatch):
    told = plain.healthy
    blind = replace(told, windows=noisier(told.windows, 1e12))
    start, coulomb = replace(plain, healthy=blind), catalogue(SYSTEM)["coulomb"]
    problem = FitProblem(plain.system, told.windows)
    at = {**told.fit.values, "coulomb.torque": 0.02}
    fit = problem.fit_one(freed(problem, plain, [coulomb], told.fit, at))
    # Forty times the size of a usual small fault.
    much = 40.0 * plain.system.parameter("coulomb.torque").prior_sd
    claim = Hypothesis(coulomb, (), replace(fit, values={**fit.values, "coulomb.torque": much}))
    monkeypatch.setattr(seen_when_healthy, "compared", lambda *a: [True])
    assert consistent_with_healthy(start, problem, [claim]) == [True]
    assert consistent_with_healthy(plain, problem, [claim]) == [False]


def test_an_effect_of_any_machine_ends_the_learning(plain):
    told = plain.healthy
    counted, problem = told.counted()
    coulomb = catalogue(SYSTEM)["coulomb"]
    at = {**told.fit.values, "coulomb.torque": 0.01}
    fit = problem.fit_one(freed(problem, counted, [coulomb], told.fit, at))
    candidates = (
        Candidate(coulomb, fit, 60.0, 50.0),
        Candidate(catalogue(SYSTEM)["lag"], told.fit, 9.0, 2.0),
    )
    ranking = Ranking(told.fit, candidates, dispersion(told.fit, problem.windows), 1.0, 500.0)
    assert not is_of_any_machine(problem, counted, ranking)
    # Of a machine that is known so roughly, this friction says nothing.
    assert is_of_any_machine(problem, replace(counted, roughness=1e3), ranking)


@pytest.mark.parametrize(("causes", "again"), [(1, False), (2, True)])
def test_small_effects_are_learned_after_all_where_a_second_cause_is_named(healthy, plain, causes, again):
    logs = beside(healthy, HEAVY)
    assert logs.are_far_beyond(plain)
    base = logs.refit_of(plain)
    first = tuple(catalogue(SYSTEM)[n] for n in ("gain", "lag")[:causes])
    selected = Selected(base.reference, first, (), base.problem)
    ranking = Ranking(base.reference, (), dispersion(base.reference, base.train), 1.0, 500.0)
    explanation = Explanation(base, ranking, selected, (), ())
    found = logs.request, explanation, SimpleNamespace(verdict="cause")
    learned = []

    def explain(baseline, verdict="cause"):
        learned.append(baseline)
        return logs.request, explanation, SimpleNamespace(verdict=verdict)

    assert (logs.with_small_effects(found, explain) is not found) == again
    assert [len(own.effects) > 0 for own in learned] == [True] * again
    assert logs.with_small_effects(found, partial(explain, verdict="unknown")) is found


@pytest.mark.study
@pytest.mark.parametrize("friction", [0.02, 0.005])
def test_a_cause_is_named_whether_or_not_small_effects_of_the_healthy_log_were_learned(friction):
    unit = {"coulomb": {"torque": friction}}
    healthy = hidden_log("rod_pendulum", unit, "chirp", SEED, 12.0)
    steps = []
    log = hidden_log("rod_pendulum", {**unit, "gain": {"factor": 0.6}}, "steps", SEED, 20.0)
    result = diagnose([log], "rod_pendulum", [healthy], progress=steps.append)
    assert result.names == ("gain",)
    assert result.causes[0].parameters["gain.factor"].value == pytest.approx(0.6, rel=0.03)
    # The refit that has told how far the log is from the healthy one is that of the diagnosis.
    first = steps.index("fitting every cause")
    assert "refit of the simulation as given" not in steps[:first]


@pytest.mark.study
def test_a_log_of_the_healthy_unit_shows_nothing_because_its_friction_is_learned(healthy):
    steps = []
    same = hidden_log("rod_pendulum", DRY, "steps", SEED, 20.0)
    assert diagnose([same], "rod_pendulum", [healthy], progress=steps.append).verdict == "nothing"
    assert any(s.startswith("healthy logs: fitting every cause") for s in steps)

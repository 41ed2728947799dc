"""Run-to-run variance and floor of a unit, estimated from its healthy logs."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence import seen_when_healthy
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.seen_when_healthy import Hypothesis, consistent_with_healthy
from deepkoco.diagnose.healthy import learn_baseline
from deepkoco.diagnose.per_log_refits import run_to_run
from deepkoco.diagnose.report.text import noise_of
from deepkoco.diagnose.run_to_run import (
    LogInformation,
    RunToRun,
    log_information,
    posterior,
    sampling_variance,
    within_bounds,
)
from deepkoco.fit.data.windows import cut_windows, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import make_system
from tests.oracle.unit import HiddenUnit, hidden_log

SYSTEM = make_system("rod_pendulum")
LENGTH, SECONDS, SEED = window_length(SYSTEM), 10.0, 77
DRIVES = ("chirp", "steps", "chirp", "steps")


def healthy(*hidden) -> Healthy:
    """Logs of one unit, each with something else beside it, and their pooled fit."""
    logs = [
        hidden_log("rod_pendulum", own, drive, SEED, SECONDS)
        for own, drive in zip(hidden, DRIVES, strict=False)
    ]
    windows = cut_windows(logs, SYSTEM, LENGTH)
    start = baseline_from(SYSTEM, windows)
    windows, fit = refit_sharply(start, windows)
    return Healthy(tuple(logs), windows, start, (), fit)


@pytest.mark.study
def test_run_to_run_separates_variation_from_the_floor():
    change = [0.0, 0.03, 0.06, 0.09]
    unit = healthy(*({"viscous": {"change": c}} if c else {} for c in change))
    assert unit.fit.chi2 / unit.windows.samples > 10.0  # no single friction explains all four
    runs = run_to_run(unit, unit.before.prior)
    assert len(runs.log_information) == 4
    assert runs.floor < 1.2
    spread = dict(zip(unit.before.prior.names, np.sqrt(np.diag(runs.covariance)), strict=True))
    assert spread["viscous"] == pytest.approx(np.std(change, ddof=1), rel=0.1)
    learned = runs.of_another(unit.before.prior)
    sd = dict(zip(learned.names, np.sqrt(np.diag(learned.covariance)), strict=True))
    assert sd["viscous"] > spread["viscous"]
    # What did not vary is not blurred by what did.
    assert sd["gravity"] < 0.05


def test_run_to_run_is_small_for_a_constant_unit():
    unit = healthy({}, {}, {})
    runs = run_to_run(unit, unit.before.prior)
    spread = np.sqrt(np.diag(runs.covariance))
    declared = np.sqrt(np.diag(unit.before.prior.covariance))
    assert (spread < 0.2 * declared).all()
    assert runs.floor < 1.1


def test_run_to_run_is_none_for_a_single_log():
    unit = healthy({})
    assert run_to_run(unit, unit.before.prior) is None


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(1.0, 1000.0))
def test_posterior_and_sampling_variance_agree_with_linear_least_squares(seed, deflation):
    rng = np.random.default_rng(seed)
    names = ("a", "b", "c")
    slopes = rng.normal(size=(8, 3)) * 10.0 ** rng.uniform(-2.0, 2.0, 3)
    root = rng.normal(size=(3, 3))
    prior = Prior(names, np.zeros(3), root @ root.T + 0.1 * np.eye(3))
    precision, data = np.linalg.inv(prior.covariance), slopes.T @ slopes
    order = [2, 0, 1]
    covariance = np.linalg.inv(data + precision)
    fit = SimpleNamespace(free=tuple(names[i] for i in order), covariance=covariance[np.ix_(order, order)])
    # Noise of this variance reaches the estimate through the gain of the fit.
    gain = covariance @ slopes.T
    np.testing.assert_allclose(
        sampling_variance(fit, prior, deflation), deflation * np.diag(gain @ gain.T), rtol=1e-4, atol=1e-8
    )
    wide = posterior(fit, prior, deflation)
    np.testing.assert_allclose(wide, np.linalg.inv(data / deflation + precision), rtol=1e-5, atol=1e-9)
    assert np.linalg.eigvalsh(prior.covariance - wide).min() > -1e-6


def claimed(start, effort: float):
    """An offset of that size, as another log of the unit shows it."""
    hidden = {"torque_bias": {"effort": effort}}
    windows = cut_windows([hidden_log("rod_pendulum", hidden, "steps", SEED, SECONDS)], SYSTEM, LENGTH)
    windows, reference = refit_sharply(start, windows)
    problem, cause = FitProblem(start.system, windows), catalogue(SYSTEM)["torque_bias"]
    prior = prior_with(problem, start, [cause], reference.values)
    trial = Trial(cause.name, prior.names, prior, reference.values, reference.state, reference.nuisance)
    return problem, Hypothesis(cause, (), problem.fit([trial])[0])


@pytest.mark.study
def test_consistent_with_healthy_holds_for_the_effect_of_one_healthy_log_only():
    unit = [{}, {"torque_bias": {"effort": 0.003}}]
    logs = [
        hidden_log("rod_pendulum", own, drive, SEED, SECONDS)
        for own, drive in zip(unit, DRIVES, strict=False)
    ]
    start = learn_baseline(logs, SYSTEM, LENGTH)
    assert len(start.runs.log_information) == 2
    assert "torque_bias" not in start.effects  # too small to be learned
    problem, same = claimed(start, 0.003)
    assert consistent_with_healthy(start, problem, [same]) == [True]
    problem, more = claimed(start, 0.05)
    assert consistent_with_healthy(start, problem, [more]) == [False]


@pytest.mark.parametrize(
    ("logs", "before"),
    [
        (
            [(900.0, 0.0), (3.0, 0.0), (700.0, 0.1)],
            False,
        ),  # one log says nothing, and two say that it was absent
        ([(900.0, 0.0), (3.0, 60.0)], True),  # one log shows it
        ([(900.0, 0.0), (80.0, 60.0)], False),  # one log shows another size of it
        ([(3.0, 0.0), (2.0, 0.0)], True),  # no log says anything
        ([(3.0, 0.0)], True),
    ],
)
def test_a_healthy_log_that_says_nothing_does_not_answer_those_that_do(logs, before, monkeypatch):
    known = [seen_when_healthy.Told(unlike, {}, shown) for unlike, shown in logs]
    asked = iter(known)
    monkeypatch.setattr(seen_when_healthy, "_healthy_estimates", lambda *_: [next(asked)])
    monkeypatch.setattr(seen_when_healthy, "_chi2_between", lambda *given: [a.unlike for a in given[-1]])
    windows = SimpleNamespace(log=np.arange(len(logs)))
    start = SimpleNamespace(healthy=SimpleNamespace(windows=windows, causes=()), runs=None)
    cause = Hypothesis(catalogue(SYSTEM)["coulomb"], (), None)
    # Without run-to-run variance, the logs must also agree on one unit that has it.
    for together in (0.0, 900.0):
        asked = iter(known)
        monkeypatch.setattr(seen_when_healthy, "_chi2_together", lambda *_, chi2=together: [chi2])
        found = seen_when_healthy.compared(start, None, start.healthy, [cause])
        assert found == [before and together == 0.0]


@pytest.mark.study
def test_diagnose_names_only_changes_beyond_the_run_to_run_variance():
    change = [0.0, 0.06, 0.03]
    logs = [
        hidden_log("rod_pendulum", {"viscous": {"change": c}} if c else {}, drive, SEED, SECONDS)
        for c, drive in zip(change, DRIVES, strict=False)
    ]
    start = learn_baseline(logs, SYSTEM, LENGTH)
    only = ["gain", "viscous", "coulomb"]
    log = hidden_log("rod_pendulum", {"viscous": {"change": 0.09}}, "steps", SEED, SECONDS)
    result = diagnose([log], "rod_pendulum", baseline=start, only=only)
    assert result.verdict == "nothing"
    unit = {"viscous": {"change": 0.03}, "coulomb": {"torque": 0.05}}
    rubbing = hidden_log("rod_pendulum", unit, "steps", SEED, SECONDS)
    assert diagnose([rubbing], "rod_pendulum", baseline=start, only=only).names == ("coulomb",)
    # A report says what the healthy logs leave, and how they vary.
    said = json.loads(json.dumps(result.to_json()))["data"]["healthy"]
    assert said["logs"] == 3
    assert said["run_to_run"]["viscous"]["sd"] == pytest.approx(np.std(change, ddof=1), rel=0.2)
    assert said["run_to_run"]["viscous"]["unit"] == "N m s/rad"
    assert "sensor noise" in noise_of(result)
    noisy = replace(result, data={**result.data, "healthy": {**said, "chi2_per_sample": 7.0}})
    assert (
        noise_of(noisy)
        == "the error that remains in the healthy logs (7 times the variance of the sensor noise)"
    )
    assert noise_of(replace(result, data={})) == "sensor noise"


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_of_another_combines_logs_as_random_effects(seed, blind):
    """Against the dense normal distribution of the mean, every log's own parameters and its data."""
    rng = np.random.default_rng(seed)
    names, logs = ("a", "b"), 3
    prior = Prior(names, rng.normal(size=2), np.diag(rng.uniform(0.5, 2.0, 2)))
    runs = RunToRun({}, np.diag(rng.uniform(0.01, 1.0, 2)), 10**9, 1.0, 1.0, 0.0)  # so many that t is normal
    slopes = [rng.normal(size=(4, 2)) for _ in range(logs)]
    if blind:
        slopes[0][:, 1] = 0.0
    seen = [a @ rng.normal(size=2) + rng.normal(size=4) for a in slopes]
    precision = np.linalg.inv(prior.covariance)
    for k, (a, y) in enumerate(zip(slopes, seen, strict=True)):
        covariance = np.linalg.inv(a.T @ a + precision)
        at = covariance @ (a.T @ y + precision @ prior.centre)
        fit = SimpleNamespace(free=names, covariance=covariance, values=dict(zip(names, at, strict=True)))
        runs.log_information[k] = log_information(fit, prior, 1.0)
        np.testing.assert_allclose(runs.log_information[k].information, a.T @ a, atol=1e-8)
    # mean, then what each log differs by: each measurement is linear in them
    everything = np.linalg.inv(
        np.block(
            [
                [prior.covariance + runs.covariance, np.zeros((2, 6))],
                [np.zeros((6, 2)), np.kron(np.eye(3), runs.covariance)],
            ]
        )
    )
    rows = np.zeros((4 * logs, 2 + 2 * logs))
    for k, a in enumerate(slopes):
        rows[4 * k : 4 * k + 4, :2] = rows[4 * k : 4 * k + 4, 2 + 2 * k : 4 + 2 * k] = a
    whole = np.linalg.inv(everything + rows.T @ rows)
    centre = np.concatenate([prior.centre, np.zeros(2 * logs)])
    best = whole @ (everything @ centre + rows.T @ np.concatenate(seen))
    found = runs.of_another(prior)
    np.testing.assert_allclose(found.centre, best[:2], atol=1e-6)
    np.testing.assert_allclose(found.covariance, whole[:2, :2] + runs.covariance, rtol=1e-3)
    fewer = RunToRun(
        {k: own for k, own in runs.log_information.items() if k != 1},
        runs.covariance,
        10**9,
        1.0,
        1.0,
        0.0,
    )
    np.testing.assert_allclose(runs.of_another(prior, 1).centre, fewer.of_another(prior).centre)


def test_doubted_inflates_the_variance_of_few_logs():
    prior = Prior(("a",), np.zeros(1), np.eye(1))
    told = {0: LogInformation(np.eye(1) * 1e9, np.zeros(1)), 1: LogInformation(np.eye(1) * 1e9, np.zeros(1))}
    sd = [
        np.sqrt(RunToRun(told, np.eye(1) * 1e-4, k, 1.0, 1.0, 0.0).of_another(prior).covariance[0, 0])
        for k in (1, 3, 1000)
    ]
    assert sd[2] == pytest.approx(0.01 * np.sqrt(1.5), rel=0.01)  # its own, and that of a mean of two
    assert sd[0] > 1.2 * sd[1] > 1.2 * sd[2]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 6))
def test_doubted_is_the_interval_of_a_further_log(seed, count):
    """Against draws from the posterior of a mean that is known, far above the scale of the half-Cauchy prior."""
    rng = np.random.default_rng(seed)
    squares, degrees = float(rng.uniform(0.5, 2.0)), count - 1
    found = RunToRun({}, np.eye(1) * squares / (degrees + 1.0 / 3.0), degrees, 1.0, 1.0, 0.0).doubted[0, 0]
    variance = scipy.stats.invgamma(0.5 * count, scale=0.5 * squares).rvs(400_000, random_state=rng)
    further = np.sqrt(variance) * rng.standard_normal(len(variance))
    assert 1.96 * np.sqrt(found) == pytest.approx(np.quantile(np.abs(further), 0.95), rel=0.03)


@pytest.mark.study
def test_consistent_with_healthy_is_false_for_a_bias_beside_large_variation():
    change = [0.0, 0.06, 0.12]
    logs = [
        hidden_log("rod_pendulum", {"viscous": {"change": c}} if c else {}, drive, SEED, SECONDS)
        for c, drive in zip(change, DRIVES, strict=False)
    ]
    logs.append(shortened(logs[0], 2.0))  # too short to say anything; it allows nothing either
    start = learn_baseline(logs, SYSTEM, LENGTH)
    assert start.effects == ()
    assert start.floor < 1.2
    problem, bias = claimed(start, 0.01)
    assert consistent_with_healthy(start, problem, [bias]) == [False]


@pytest.mark.study
def test_learn_baseline_finds_common_effects_beside_run_to_run_variance():
    hidden = {"torque_bias": {"effort": 0.006}, "load_friction": {"coefficient": 0.025}}
    logs = [
        hidden_log("rod_pendulum", hidden, drive, SEED, 12.0, take=k, varies=0.02)
        for k, drive in enumerate(("chirp", "steps", "closed-loop"), start=1)
    ]
    start = learn_baseline(logs, SYSTEM, LENGTH)
    # Nothing else stands for what the logs differ by.
    assert sorted(start.effects) == ["load_friction", "torque_bias"]
    assert start.values["torque_bias.effort"] == pytest.approx(0.006, abs=0.0005)
    assert start.values["load_friction.coefficient"] == pytest.approx(0.025, abs=0.001)
    assert start.floor < 1.1


@pytest.mark.study
def test_learn_baseline_does_not_count_common_effects_as_variance():
    """Without Coulomb friction in the baseline, refits of viscous friction differ between commands."""
    hidden = {"coulomb": {"torque": 0.02}}
    logs = [
        hidden_log("rod_pendulum", hidden, drive, SEED, SECONDS, take=k) for k, drive in enumerate(DRIVES[:3])
    ]
    start = learn_baseline(logs, SYSTEM, LENGTH)
    assert start.effects == ("coulomb",)
    assert start.values["coulomb.torque"] == pytest.approx(0.02, abs=0.002)
    without = healthy(*(hidden,) * 3)
    before = run_to_run(without, without.before.prior)
    at = without.before.prior.names.index("viscous")
    assert start.runs.covariance[at, at] < 0.5 * before.covariance[at, at]


@pytest.mark.study
def test_diagnose_fits_own_parameters_for_each_log_of_a_varying_unit():
    def logs(changes, hidden, first):
        return [
            hidden_log("rod_pendulum", {**hidden, "viscous": {"change": c}}, drive, SEED, SECONDS, take=k)
            for k, (c, drive) in enumerate(zip(changes, DRIVES, strict=False), start=first)
        ]

    start = learn_baseline(logs([0.02, 0.06, 0.04], {}, 1), SYSTEM, LENGTH)
    only = ["gain", "quadratic", "coulomb", "torque_bias"]
    given = {"baseline": start, "only": only}
    later = [0.03, 0.08]
    assert diagnose(logs(later, {}, 5), "rod_pendulum", **given).verdict == "nothing"
    explained = logs(later, {"coulomb": {"torque": 0.05}}, 5)
    rubbing = diagnose(explained, "rod_pendulum", **given)
    assert rubbing.names == ("coulomb",)
    # Reports and models are about these logs, whatever others may be like.
    own = HiddenUnit("rod_pendulum", {}, SEED).parameters["viscous"]
    assert rubbing.model.parameter("viscous").value == pytest.approx(own + np.mean(later), abs=0.003)
    assert rubbing.causes[0].parameters["coulomb.torque"].value == pytest.approx(0.05, abs=0.005)
    # So has a log that is kept back.
    tested = diagnose(logs([0.03], {}, 5), "rod_pendulum", holdout=logs([0.08], {}, 6), **given)
    assert tested.verdict == "nothing"
    assert tested.gain.channels[0].refit < 1.2 * tested.data["noise_sd"][0]
    assert (
        tested.gain.channels[0].baseline > 3.0 * tested.gain.channels[0].refit
    )  # as given, nothing is fitted
    assert tested.model.parameter("viscous").value == pytest.approx(own + 0.03, abs=0.001)
    low, high = tested.refit["viscous"].low, tested.refit["viscous"].high
    assert low < own + 0.03 < high
    assert high - low < 0.01


def shortened(log, seconds: float):
    """The first seconds of a log."""
    channels = {
        name: replace(series, t=series.t[series.t < seconds], value=series.value[series.t < seconds])
        for name, series in log.channels.items()
    }
    return replace(log, channels=channels)


@pytest.mark.study
def test_of_another_accepts_parameters_of_very_different_units():
    prior = Prior(("angle", "speed"), np.zeros(2), np.diag([0.02**2, 3.0**2]))
    fit = SimpleNamespace(
        free=prior.names, covariance=np.diag([1e-18, 9.0]), values={"angle": 0.01, "speed": 0.0}
    )
    runs = RunToRun({0: log_information(fit, prior, 1.0)}, np.zeros((2, 2)), 1, 1.0, 1.0, 0.0)
    found = runs.of_another(prior)
    np.testing.assert_allclose(found.centre, [0.01, 0.0], atol=1e-9)
    np.testing.assert_allclose(np.diag(found.covariance), [1e-18, 9.0], rtol=1e-6)


def test_within_bounds_moves_correlated_parameters_together():
    """The logs determine the sum, 0.8 ms, although one of its parts was estimated below 0."""
    start = baseline_from(
        SYSTEM, cut_windows([hidden_log("rod_pendulum", {}, "chirp", SEED, 5.0)], SYSTEM, LENGTH)
    )
    names = ("actuation_delay.delay", "lag.time_constant")
    covariance = 0.04**2 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + 1e-10 * np.eye(2)
    moved = within_bounds(Prior(names, np.array([-0.0036, 0.0044]), covariance), start.system)
    assert moved.centre.min() >= 0.0
    assert moved.centre.sum() == pytest.approx(0.0008, abs=2e-5)
    inside = Prior(names, np.array([0.001, 0.002]), covariance)
    assert within_bounds(inside, start.system) is inside

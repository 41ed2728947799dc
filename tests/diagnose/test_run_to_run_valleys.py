"""Run-to-run variance where the logs tell sums and products of parameters, but not the parameters themselves."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.baseline import catalogue_system
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.seen_when_healthy import consistent_with_healthy
from deepkoco.diagnose.healthy import learn_baseline
from deepkoco.diagnose.little_of_all import with_little
from deepkoco.diagnose.run_to_run import (
    LogInformation,
    RunToRun,
    least_variance,
    log_information,
    unshown,
)
from deepkoco.diagnose.variances_between import VAGUE, Differences, variances_between
from deepkoco.fit.solve.prior import Prior
from experiments.studies.diagnosis.heavier_load import LightBench
from tests.diagnose.test_run_to_run import LENGTH, SECONDS, SEED, SYSTEM, claimed
from tests.oracle.unit import hidden_log

NAMES = ("a", "b")
KNOWN = 1e-4  # standard deviation to which a log tells the logarithm of a product


def told_of_product(at: tuple[float, float], prior: Prior) -> SimpleNamespace:
    """Fit of a log that tells a * b alone, with slopes at some values."""
    slope = np.array([1.0 / at[0], 1.0 / at[1]]) / KNOWN
    covariance = np.linalg.inv(np.outer(slope, slope) + prior.precision(NAMES))
    return SimpleNamespace(free=NAMES, values=dict(zip(NAMES, at, strict=True)), covariance=covariance)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_logs_at_different_places_of_a_curved_valley_leave_it_open(seed):
    rng = np.random.default_rng(seed)
    prior = Prior(NAMES, np.ones(2), 0.09 * np.eye(2))
    shared = told_of_product((1.0, 1.0), prior)
    told = {}
    for log in range(3):
        a = 1.0 + 0.02 * rng.normal()  # each refit stops somewhere along the valley
        told[log] = log_information(told_of_product((a, 1.0 / a), prior), prior, 1.0, shared)
    runs = RunToRun(told, 1e-8 * np.eye(2), 2, 1.0, 1.0, 0.0)
    found = runs.of_another(prior)
    assert found.centre.sum() == pytest.approx(2.0, abs=0.005)  # the tangent at (1, 1)
    along = np.array([1.0, -1.0]) / np.sqrt(2.0)
    assert along @ found.covariance @ along == pytest.approx(0.09, rel=0.05)


def test_of_another_is_centred_on_the_mean_that_a_fit_of_all_logs_found():
    prior = Prior(NAMES, np.zeros(2), np.eye(2))
    told = {
        k: LogInformation(100.0 * np.eye(2), 100.0 * np.array([x, 0.0]))
        for k, x in enumerate((1.0, 2.0, 3.0))
    }
    plain = RunToRun(told, 1e-6 * np.eye(2), 2, 1.0, 1.0, 0.0)
    fitted = RunToRun(told, 1e-6 * np.eye(2), 2, 1.0, 1.0, 0.0, mean=np.array([5.0, 7.0]))
    np.testing.assert_allclose(fitted.of_another(prior).centre, [5.0, 7.0])
    np.testing.assert_allclose(fitted.of_another(prior).covariance, plain.of_another(prior).covariance)
    # Without a log, the mean moves by as much as without a fit.
    moved = plain.of_another(prior, 0).centre - plain.of_another(prior).centre
    np.testing.assert_allclose(fitted.of_another(prior, 0).centre, [5.0 + moved[0], 7.0 + moved[1]])
    assert moved[0] > 0.4


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_variances_between_finds_what_a_sum_alone_shows(seed):
    rng = np.random.default_rng(seed)
    prior = Prior(NAMES, np.zeros(2), np.eye(2))
    # A log shows the sum to 0.001, and the difference to 0.5 only.
    ways = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
    precision = ways.T @ np.diag([1e6, 4.0]) @ ways
    sums = rng.normal(size=5)
    sums *= 0.3 / np.std(sums)
    apart = 0.5 * rng.normal(size=5)
    pulls = [precision @ (s * ways[0] + d * ways[1]) for s, d in zip(sums, apart, strict=True)]
    logs = [LogInformation(precision, pull) for pull in pulls]
    # The single estimates may differ by no more than their errors; then the search starts without variance.
    found = variances_between(logs, prior, np.zeros(2))
    likelihood = Differences(
        [precision] * 5, pulls, VAGUE * np.eye(2), np.full(2, np.inf), np.full(2, np.inf)
    ).log_likelihood
    best = max(
        -scipy.optimize.minimize(lambda x: -likelihood(np.exp(x)), np.log(at), method="Nelder-Mead").fun
        for at in ((0.1, 0.1), (0.2, 0.01), (0.01, 0.2))
    )
    assert likelihood(found) > best - 0.1
    assert likelihood(found) > likelihood(np.zeros(2)) + 100.0


def test_variances_between_are_finite_where_rounding_makes_an_information_negative():
    prior = Prior(NAMES, np.zeros(2), np.eye(2))
    logs = [LogInformation(np.diag([1e7, -1e-8]), np.array([1e7 * x, 1e-8 * x])) for x in (0.01, -0.02, 0.03)]
    found = variances_between(logs, prior, np.array([1e-4, 1e-3]), np.array([1.0, 1.0]))
    assert np.isfinite(found).all()
    assert found[0] == pytest.approx(np.var([0.01, -0.02, 0.03], ddof=1), rel=0.05)
    assert found[1] <= 1.0


@pytest.mark.study
def test_consistent_with_healthy_takes_a_baseline_with_a_little_of_further_effects():
    logs = [hidden_log("rod_pendulum", {}, drive, SEED, SECONDS) for drive in ("chirp", "steps")]
    start = learn_baseline(logs, SYSTEM, LENGTH)
    sizes = [start.system.parameter("quadratic.drag")]
    start = with_little(start, {catalogue(SYSTEM)["quadratic"]: sizes}, 1.0)
    assert len(start.prior.names) > len(start.runs.doubted)
    problem, bias = claimed(start, 0.05)
    assert consistent_with_healthy(start, problem, [bias]) == [False]


def test_a_single_healthy_log_leaves_open_what_few_logs_cannot_show():
    system = LightBench()
    extended = catalogue_system(system)
    sizes = {
        "servo_gain": 410.0,
        "torque_constant": 0.37,
        "actuation_delay.delay": 0.01,
        "coulomb.torque": 0.02,
        "viscous": 0.0,
    }
    found = np.sqrt(np.diag(unshown(extended, tuple(sizes), sizes, ["torque_constant"])))
    # The gain is declared to 0.1, the constant fixes a scale, a delay is none of the unit's own. Units of one
    # make differ by 10 % of a friction of 0.02 N m, and by a tenth of what is declared of one that shows none.
    np.testing.assert_allclose(found, [0.01, 0.0, 0.0, 0.002, 0.001], atol=1e-12)
    several = np.sqrt(least_variance(extended, tuple(sizes), sizes, ["torque_constant"]))
    np.testing.assert_allclose(several, 0.5 * found, atol=1e-12)


def test_logs_that_agree_leave_the_usual_variation_open():
    prior = Prior(NAMES, np.zeros(2), np.eye(2))
    told = {k: LogInformation(1e6 * np.eye(2), np.zeros(2)) for k in range(3)}
    runs = RunToRun(told, np.diag([0.0, 0.04]), 2, 1.0, 1.0, 0.0, least=np.array([1e-4, 1e-4]))
    found = np.sqrt(np.diag(runs.of_another(prior).covariance))
    assert found[0] == pytest.approx(0.01, rel=0.01)
    assert found[1] >= 0.2  # what the logs show is more


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_restricted_likelihood_is_that_of_the_dense_normal_distribution(seed):
    rng = np.random.default_rng(seed)
    scale, logs = rng.uniform(0.5, 2.0, 2), 3
    prior = Prior(NAMES, rng.normal(size=2), np.diag(scale**2))
    slopes = [rng.normal(size=(3, 2)) for _ in range(logs)]
    seen = [a @ rng.normal(size=2) + rng.normal(size=3) for a in slopes]
    data = [(a * scale).T @ (a * scale) for a in slopes]
    pulls = [scale * (a.T @ (y - a @ prior.centre)) for a, y in zip(slopes, seen, strict=True)]
    found = Differences(data, pulls, VAGUE * np.eye(2), np.full(2, np.inf), np.full(2, np.inf))
    rows, rest = (
        np.vstack(slopes),
        np.concatenate([y - a @ prior.centre for a, y in zip(slopes, seen, strict=True)]),
    )

    def dense(variance):
        own = np.zeros((3 * logs, 3 * logs))
        for k, a in enumerate(slopes):
            own[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = a @ np.diag(variance * scale**2) @ a.T
        covariance = own + np.eye(3 * logs) + rows @ np.diag(scale**2 / VAGUE) @ rows.T
        return -0.5 * (rest @ np.linalg.solve(covariance, rest) + np.linalg.slogdet(covariance)[1])

    one, other = rng.uniform(0.01, 2.0, (2, 2))
    wanted = dense(one) - dense(other)
    assert found.log_likelihood(one) - found.log_likelihood(other) == pytest.approx(wanted, abs=1e-6)


def test_variances_that_the_logs_do_not_show_stay_zero():
    # One log tells a parameter well, two others hardly: they differ from it by no more than their errors.
    prior = Prior(("a",), np.zeros(1), np.eye(1))
    logs = [
        LogInformation(np.array([[1.0 / sd**2]]), np.array([x / sd**2]))
        for x, sd in ((0.0, 1e-3), (0.1, 0.1), (0.05, 0.06))
    ]
    assert variances_between(logs, prior, np.zeros(1))[0] == 0.0

"""Normal and log-normal priors."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.fit import Trial
from deepkoco.fit.solve.prior import Prior
from tests.fit.test_fit import free_swing, problem_of

NAMES = ("constant", "resistance", "offset")


def drawn(seed: int) -> Prior:
    rng = np.random.default_rng(seed)
    root = 0.3 * rng.normal(size=(3, 3))
    centre = np.array([0.3, 2.0, rng.normal()])
    covariance = (root @ root.T + 0.01 * np.eye(3)) * np.outer([0.3, 2.0, 1.0], [0.3, 2.0, 1.0])
    return Prior(NAMES, centre, covariance, frozenset(NAMES[:2]))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_penalty_is_that_of_a_normal_distribution_of_logarithms(seed):
    prior, rng = drawn(seed), np.random.default_rng(seed + 1)
    values = np.append(prior.centre[:2] * np.exp(rng.normal(size=2)), rng.normal())
    precision, offset = prior.penalty(NAMES).at(values)
    # In y = (log a, log b, c) the covariance is C divided by the centres; its density is normal.
    scale = np.append(prior.centre[:2], 1.0)
    away = np.append(np.log(values[:2] / prior.centre[:2]), values[2] - prior.centre[2])
    wanted = away @ np.linalg.solve(prior.covariance / np.outer(scale, scale), away)
    assert offset @ precision @ offset == pytest.approx(wanted, rel=1e-9)
    # Twice its slope by the values, from central differences.
    h = 1e-6 * np.abs(values)
    sides = [[cost(prior, values + s * h[i] * np.eye(3)[i]) for s in (1.0, -1.0)] for i in range(3)]
    slope = [(up - down) / (2.0 * h[i]) for i, (up, down) in enumerate(sides)]
    assert 2.0 * precision @ offset == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.abs(slope).max())


def cost(prior: Prior, values: np.ndarray) -> float:
    precision, offset = prior.penalty(NAMES).at(values)
    return float(offset @ precision @ offset)


def test_a_log_normal_prior_keeps_a_ratio_that_a_normal_one_gives_up():
    # What three healthy logs tell of a motor: each to 14 and 18 %, their ratio to 5 %.
    centre, spread = np.array([0.28, 1.62]), np.array([0.14, 0.18])
    covariance = np.outer(centre * spread, centre * spread) * np.array([[1.0, 0.986], [0.986, 1.0]])
    normal = Prior(NAMES[:2], centre, covariance)
    ratios = replace(normal, lognormal=frozenset(NAMES[:2]))
    twice = np.array([0.38 * 0.28, 0.19 * 1.62])  # twice the ratio

    def penalty(prior):
        precision, offset = prior.penalty(NAMES[:2]).at(twice)
        return offset @ precision @ offset

    assert penalty(normal) < 25.0
    assert penalty(ratios) > 200.0


def test_a_fit_under_a_log_normal_prior_ends_at_the_minimum_of_its_cost():
    # The motion tells 11 m/s2; a narrow prior at 5 pulls far from it, where its offset is no difference any more.
    problem, values = problem_of(free_swing(omega=math.sqrt(16.5), amplitude=0.02, noise=0.002))
    name = ("gravity",)
    prior = Prior(name, np.array([5.0]), np.array([[0.05**2]]), frozenset(name))
    fit = problem.fit([Trial("swing", name, prior, values)], 60)[0]

    def cost_at(gravity: float) -> float:
        _, chi2 = problem.fit_states({**values, "gravity": gravity}, fit.state)
        return float(chi2.sum()) + (5.0 * math.log(gravity / 5.0) / 0.05) ** 2

    best = scipy.optimize.minimize_scalar(cost_at, bounds=(4.0, 11.0), method="bounded")
    assert 5.5 < best.x < 10.5  # both count
    assert fit.values["gravity"] == pytest.approx(best.x, rel=2e-3)
    assert fit.cost == pytest.approx(best.fun, abs=0.05)
    # What the data tell does not depend on the prior.
    at = Prior(name, np.array([fit.values["gravity"]]), np.array([[1e4]]))
    alone = problem.fit([Trial("swing", name, at, fit.values, fit.state)], 1)[0]
    assert fit.information[0, 0] == pytest.approx(alone.information[0, 0], rel=1e-6)

"""Planning by samples: optima that are known, loops that do not mix, plans that are moved on, costs that are none."""

import numpy as np
import pytest

from deepkoco.planning.sampling import SamplingConfig, SamplingPlanner

GOALS = np.array([[0.5, -0.2], [-0.7, 0.9]])
LOW, HIGH = np.array([-1.0, -1.0]), np.array([1.0, 1.0])


def quadratic(plans: np.ndarray) -> np.ndarray:
    """The least cost of loop e is at its goal, at every action."""
    return ((plans - GOALS[:, None, None]) ** 2).sum((2, 3))


def planner(seed: int = 0, **settings) -> SamplingPlanner:
    usual = {"horizon": 4, "samples": 200, "iterations": 12, "elites": 20}
    config = SamplingConfig(**{**usual, **settings})
    return SamplingPlanner(config, 2, LOW, HIGH, np.random.default_rng(seed))


@pytest.mark.parametrize("method", ["mppi", "cem"])
def test_each_loop_finds_its_own_optimum(method: str):
    found = planner(method=method, spread=0.4, correlation=0.0, least_spread=0.01, temperature=0.1)
    for _ in range(6):
        action = found.decide(quadratic)
    np.testing.assert_allclose(action, GOALS, atol=0.06)


def test_mppi_weighs_by_hand():
    """Costs 0 and 1 with a deviation of 1/2 and temperature 2: weights 1 and exp(-1), over their sum."""
    config = SamplingConfig(horizon=1, samples=4, iterations=1, elites=2, temperature=2.0)
    own = SamplingPlanner(config, 1, LOW[:1], HIGH[:1], np.random.default_rng(0))
    seen = []

    def costs(plans: np.ndarray) -> np.ndarray:
        seen.append(plans)
        return np.array([[0.0, 1.0, 0.0, 1.0]])

    action = own.decide(costs)
    weights = np.array([1.0, np.exp(-1.0), 1.0, np.exp(-1.0)])
    assert action[0, 0] == pytest.approx((weights / weights.sum()) @ seen[0][0, :, 0, 0])


def test_cem_takes_the_mean_of_the_elites():
    config = SamplingConfig(method="cem", horizon=1, samples=5, iterations=1, elites=2)
    own = SamplingPlanner(config, 1, LOW[:1], HIGH[:1], np.random.default_rng(0))
    seen = []

    def costs(plans: np.ndarray) -> np.ndarray:
        seen.append(plans)
        return np.array([[3.0, 2.0, 0.0, 9.0, 1.0]])

    assert own.decide(costs)[0, 0] == pytest.approx(seen[0][0, [2, 4], 0, 0].mean())


def test_the_next_decision_begins_at_the_plan_moved_on_by_one_step():
    own, seen = planner(iterations=1), []

    def costs(plans: np.ndarray) -> np.ndarray:
        seen.append(plans[:, 0].copy())
        return quadratic(plans)

    own.decide(costs)
    plan = own.plan.copy()
    own.decide(costs)
    np.testing.assert_array_equal(seen[1], np.concatenate([plan[:, 1:], plan[:, -1:]], 1))


@pytest.mark.parametrize("method", ["mppi", "cem"])
def test_costs_that_are_no_numbers_are_not_taken(method: str):
    own = planner(method=method, spread=0.4, iterations=20, elites=10, correlation=0.0, temperature=0.05)

    def costs(plans: np.ndarray) -> np.ndarray:
        found = quadratic(plans)
        found[plans[..., 0, 0] > 0.2] = np.nan
        return found

    action = own.decide(costs)
    assert (action[:, 0] <= 0.2).all()
    assert action[0, 0] > 0.0


@pytest.mark.parametrize("method", ["mppi", "cem"])
def test_where_no_cost_is_a_number_the_plan_stays(method: str):
    own = planner(method=method)
    own.decide(quadratic)
    plan = own.plan.copy()
    own.decide(lambda plans: np.full(plans.shape[:2], np.inf))
    np.testing.assert_array_equal(own.plan[:, :-1], plan[:, 1:])


def test_a_decision_follows_from_its_seed_and_stays_within_the_range():
    actions = [planner(seed, iterations=1, spread=5.0).decide(quadratic) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(actions[0], actions[1])
    assert np.abs(actions[0] - actions[2]).max() > 1e-3
    assert np.abs(actions).max() <= 1.0


def test_noise_is_correlated_as_told():
    noise = planner(samples=4000, correlation=0.7)._noise()
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    assert (noise[:, :, 1:] * noise[:, :, :-1]).mean() == pytest.approx(0.7, abs=0.03)


@pytest.mark.parametrize(
    "wrong", [{"method": "best"}, {"horizon": 0}, {"samples": 2}, {"spread": 0.0}, {"correlation": 1.0}]
)
def test_settings_that_are_none_are_refused(wrong: dict):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SamplingConfig(**wrong)

"""What planners count, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.planning import PlannerConfig, PlannerStatistics, make_planner
from deepkoco.planning.statistics import planned_and_realised

CONFIG = PlannerConfig(5)


def test_plans_are_paired_with_the_costs_of_the_steps_they_predict():
    # H = 2: the plan of step 0 predicts steps 1 and 2, that of step 1 steps 2 and 3. Step 1 had no plan.
    planned = np.array([10.0, np.nan, 30.0, 40.0, 50.0])
    costs = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    np.testing.assert_array_equal(planned_and_realised(planned, costs, 2), [[10.0, 30.0], [6.0, 24.0]])
    assert planned_and_realised(planned, costs, 5).shape == (2, 0)


def test_diagnostics_describe_every_solved_plan(model, random_state):
    limit = np.array([0.3])
    planner = make_planner(model, CONFIG, -limit, limit, diagnostics=True)
    active, costs = 0, []
    for seed in range(8):
        state = random_state(model, seed)
        planner.plan(*state)
        planned = planner._program.solve(*state)
        active += int((np.abs(planned) > 0.3 - 1e-9).sum())
        costs.append(planner._program.planned_cost(planned))
    planner.plan(state[0] * np.nan, *state[1:])
    statistics = planner.statistics
    assert (statistics.plans, statistics.solved, statistics.failures) == (9, 8, 1)
    assert statistics.active_limits == active > 0
    np.testing.assert_allclose(statistics.planned_costs, [*costs, np.nan])
    means = statistics.means()
    assert means["active_limits"] == active / 8
    assert means["microseconds"] > 0
    assert means["conditioning"] > 1
    assert means["iterations"] >= 1
    planner.reset()
    assert planner.statistics.planned_costs == []
    assert planner.statistics.plans == 9


def test_diagnostics_do_not_change_the_plan(model, random_state):
    limit = np.array([1.0])
    plain, observed = (make_planner(model, CONFIG, -limit, limit, diagnostics=d) for d in (False, True))
    for seed in range(4):
        state = random_state(model, seed)
        np.testing.assert_array_equal(plain.plan(*state), observed.plan(*state))
    assert plain.statistics.solved == 0
    assert np.isnan(list(plain.statistics.means().values())).all()


def test_refined_plans_are_counted_without_diagnostics(random_model, random_state):
    limit = np.array([1.0, 1.0])
    model = random_model(1, actions=2, pairs=4)
    rows, factor, action = random_state(model, 1)
    planner = make_planner(model, PlannerConfig(13, solver="osqp"), -limit, limit)
    for scale in (1e3, 2e3):
        planner.plan(np.vstack((rows[:1], scale * rows[1:])), factor, action)
    assert (planner.statistics.plans, planner.statistics.failures) == (2, 0)
    assert planner.statistics.refined == 2


def test_sums_over_controllers():
    total = PlannerStatistics()
    total.add(
        PlannerStatistics(
            plans=3, failures=1, refined=2, solved=2, iterations=10, log_conditioning=np.log(100.0)
        )
    )
    total.add(PlannerStatistics(plans=2, refined=1, solved=2, iterations=2, seconds=4e-6))
    assert (total.plans, total.failures, total.refined, total.solved) == (5, 1, 3, 4)
    assert total.means()["iterations"] == 3
    assert total.means()["microseconds"] == pytest.approx(1.0)
    assert total.means()["conditioning"] == pytest.approx(10**0.5)


@pytest.mark.parametrize("changes", [{"form": "sparse"}, {"method": "cem"}])
def test_programs_without_a_hessian_have_no_conditioning(model, random_state, changes):
    limit = np.array([1.0])
    planner = make_planner(model, replace(CONFIG, **changes), -limit, limit, diagnostics=True)
    planner.plan(*random_state(model, 0))
    assert np.isnan(planner.statistics.means()["conditioning"])
    assert planner.statistics.means()["iterations"] > 0

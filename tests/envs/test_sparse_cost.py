"""The sparse version of a task."""

import numpy as np
import pytest

from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory


def rewards(sparse_cost: float | None) -> np.ndarray:
    config = TaskConfig("pendulum", "deepkoco/RodPendulum-v0", sparse_cost=sparse_cost)
    envs = make_task_factory(config)(30, 0)
    envs.reset(seed=4)
    collected = [envs.step(np.zeros((30, 1), dtype=np.float32))[1] for _ in range(20)]
    envs.close()
    return np.array(collected)


def test_a_step_costs_nothing_at_the_goal_and_one_elsewhere():
    plain, sparse = rewards(None), rewards(1.0)
    assert set(np.unique(sparse)) == {-1.0, 0.0}
    np.testing.assert_array_equal(sparse == 0.0, -plain <= 1.0)


def test_a_threshold_without_a_goal_is_named():
    with pytest.raises(TaskError, match=r"sparse_cost = 0\.0"):
        make_task_factory(TaskConfig("pendulum", "deepkoco/RodPendulum-v0", sparse_cost=0.0))

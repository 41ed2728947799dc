"""The loop by hand does the work that it is compared for, and what delays cost is measured at any batch."""

import pytest
import torch

from deepkoco.systems import rk4_step
from deepkoco.systems.bodies.pendulum import Pendulum
from experiments.benchmarks import delay_cost, rollout_work
from experiments.benchmarks.roofline import LANES, Roofline

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


@pytest.mark.parametrize("units", [1, 4])
def test_loop_by_hand_takes_the_steps_of_the_system(units):
    found, _ = Roofline().run(units, friction=True, steps=20)
    angle = torch.linspace(-3, 3, units * LANES)
    state = torch.stack([angle, torch.zeros_like(angle)], 1)
    parameters = rollout_work.make_parameters()["world"]
    for _ in range(20):
        state = rk4_step(
            Pendulum(), state, torch.full_like(angle, 1.5), 1 / rollout_work.WORLD_RATE, parameters
        )
    torch.testing.assert_close(
        torch.from_numpy(found.transpose(0, 2, 1).reshape(-1, 2)), state, rtol=1e-4, atol=1e-4
    )


def test_cost_of_delays_is_a_ratio_to_none():
    rows = delay_cost.measure(batch=20, policy=False, repeats=1)
    assert [row["delays"] for row in rows] == [delay_cost.NONE, delay_cost.SHARED, delay_cost.OWN]
    assert rows[0]["time_to_none"] == 1.0
    assert all(float(str(row["agent_steps_per_cpu_s"])) > 0 for row in rows)

"""The nodes of box pushing, each by itself: world and friction, sensors, inverse kinematics, guard, retreat."""

from typing import Any

import numpy as np
import pytest
import torch

from deepkoco.engines.boxpush import BoxPushWorld, Encoders, InverseKinematics, JointGuard, JointMotion
from deepkoco.engines.boxpush.guard import LEAD_LIMIT, SPEED_LIMIT
from deepkoco.engines.boxpush.motion import REACH, TOOL_SPEED
from deepkoco.engines.boxpush.retreat import home_angles
from deepkoco.engines.boxpush.sensors import TICK
from deepkoco.engines.boxpush.world import box_state, world_start
from deepkoco.graph import Input
from deepkoco.systems.boxpush import TOOL_HEIGHT, tool_pose

pytest.importorskip("mujoco")
HOME = home_angles()[1:]


def message(data: Any, time: float = 0.0, window: int = 1) -> Input:
    """The same message in the whole window, which has been there for long."""
    many = (
        {k: v[:, None].repeat(1, window, 1) for k, v in data.items()}
        if isinstance(data, dict)
        else data[:, None].repeat(1, window, 1)
    )
    batch = len(next(iter(data.values())) if isinstance(data, dict) else data)
    zero = torch.zeros(batch, window, dtype=torch.float64)
    return Input(many, zero.long(), zero - 9.0, zero - 9.0, torch.full((batch,), time, dtype=torch.float64))


def run_world(box, speeds=None, parameters=None, seconds=1.0, goals=None):
    """State after some time, the arm held at home."""
    world = BoxPushWorld(20.0)
    batch = len(box)
    angles = HOME.expand(batch, 6)
    state = world_start(world, torch.tensor(box, dtype=torch.float64), angles)
    if speeds is not None:
        state["physics"][:, 1 + 13 : 1 + 16] = torch.tensor(speeds, dtype=torch.float64)
    command = angles if goals is None else goals
    for tick in range(round(20 * seconds) + 1):
        state, seen = world.step(parameters or {}, state, {"command": message(command, tick / 20.0, 3)})
    return box_state(seen)


def test_a_box_at_rest_stays_and_the_servos_hold_the_arm():
    seen = run_world([[0.4, 0.1, 0.3]])
    np.testing.assert_allclose(seen.place[0], [0.4, 0.1, 0.04], atol=1e-3)
    assert float(seen.yaw[0]) == pytest.approx(0.3, abs=1e-3)
    assert float(seen.upright[0]) == pytest.approx(1.0, abs=1e-4)
    sag = seen.angles[0] - HOME[0]
    assert 0.002 < float(sag[1]) < 0.03
    assert float(sag.abs().max()) < 0.03


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_a_sliding_box_stops_where_its_friction_says(friction: float):
    """v^2 / (2 mu g); MuJoCo's friction is soft and its cone a pyramid, so within 10 %."""
    told = {"friction(box)": torch.tensor([friction], dtype=torch.float64)}
    seen = run_world([[0.4, 0.0, 0.0]], [[0.0, 0.8, 0.0]], told)
    assert float(seen.place[0, 1]) == pytest.approx(0.64 / (2.0 * friction * 9.81), rel=0.1)


def test_each_environment_has_its_own_friction():
    told = {"friction(box)": torch.tensor([0.2, 0.5], dtype=torch.float64)}
    seen = run_world([[0.4, 0.0, 0.0]] * 2, [[0.0, 0.8, 0.0]] * 2, told)
    assert float(seen.place[0, 1] / seen.place[1, 1]) == pytest.approx(2.5, rel=0.1)


def test_encoders_have_ticks():
    encoders = Encoders(20.0)
    world = torch.zeros(1, 25, dtype=torch.float64)
    world[:, 7:13] = 0.1234

    class Still:
        def normal(self, *shape):
            return torch.zeros(1, *shape, dtype=torch.float64)

    _, seen = encoders.step({}, {}, {"world": message(world)}, noise=Still())
    ticks = seen["angles"] / TICK
    np.testing.assert_allclose(ticks, torch.round(ticks), atol=1e-9)
    assert float((seen["angles"] - 0.1234).abs().max()) <= 0.5 * TICK


def moved(command, ticks: int = 40):
    node = InverseKinematics(20.0)
    state = {"point": tool_pose(HOME).place[:, :2], "goals": HOME.clone()}
    for _ in range(ticks):
        state, goals = node.step(
            {}, state, {"command": message(torch.tensor([command], dtype=torch.float64))}, dt=0.05
        )
    return tool_pose(goals)


def test_inverse_kinematics_follows_the_velocity_at_constant_height():
    """One second at half speed along x, full speed along y."""
    pose = moved([0.5, 1.0], 20)
    start = tool_pose(HOME).place[0]
    np.testing.assert_allclose(
        pose.place[0, :2], start[:2] + TOOL_SPEED * torch.tensor([0.5, 1.0]), atol=2e-3
    )
    assert float(pose.place[0, 2]) == pytest.approx(TOOL_HEIGHT, abs=1e-3)
    assert float(pose.axis[0, 2]) == pytest.approx(-1.0, abs=1e-3)


@pytest.mark.parametrize("command", [[5.0, 0.0], [0.0, 1.0], [-1.0, -1.0], [1.0, 1.0]])
def test_the_tool_is_sent_nowhere_out_of_reach(command: list[float]):
    place = moved(command, 120).place[0]
    for entry, (low, high) in zip(place[:2], REACH, strict=True):
        assert low - 2e-3 <= float(entry) <= high + 2e-3
    assert float(place[2]) == pytest.approx(TOOL_HEIGHT, abs=2e-3)


def test_joint_motion_integrates_speeds_within_the_ranges():
    node = JointMotion(20.0)
    state = {"goals": HOME.clone()}
    command = torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0, -9.0]], dtype=torch.float64)
    _, goals = node.step({}, state, {"command": message(command)}, dt=0.05)
    np.testing.assert_allclose((goals - HOME)[0], [0.03, 0.0, 0.0, 0.0, 0.0, -0.03], atol=1e-12)


def guarded(command, measured=None, ticks: int = 1):
    guard = JointGuard(20.0)
    state = {"goals": HOME.clone()}
    measured = HOME if measured is None else measured
    for _ in range(ticks):
        state, goals = guard.step(
            {}, state, {"command": message(command), "encoders": message({"angles": measured})}, dt=0.05
        )
    return goals


def test_the_guard_hands_on_what_is_within_its_limits():
    command = HOME + 0.05
    np.testing.assert_allclose(guarded(command), command, atol=1e-12)


def test_the_guard_limits_speed_and_lead():
    far = HOME.clone()
    far[:, 0] += 1.0
    assert float((guarded(far) - HOME)[0, 0]) == pytest.approx(0.05 * SPEED_LIMIT)
    # A joint that does not follow.
    assert float((guarded(far, ticks=40) - HOME)[0, 0]) == pytest.approx(LEAD_LIMIT)


def test_the_guard_sends_no_tool_into_the_table():
    down = HOME.clone()
    down[:, 1] += 0.3
    assert float(tool_pose(down).place[0, 2]) < -0.02
    assert float(tool_pose(guarded(down, down, 40)).place[0, 2]) >= 0.015


@pytest.mark.parametrize("wrong", [float("nan"), float("inf")])
def test_a_command_that_is_no_number_leaves_the_goals(wrong: float):
    command = HOME.clone()
    command[:, 2] = wrong
    np.testing.assert_array_equal(guarded(command), HOME)


def test_a_tool_that_is_outside_may_come_back():
    guard = JointGuard(20.0)
    below = HOME.clone()
    below[:, 1] += 0.15
    assert float(tool_pose(below).place[0, 2]) < 0.015
    _, goals = guard.step(
        {}, {"goals": below}, {"command": message(HOME), "encoders": message({"angles": below})}, dt=0.05
    )
    assert float(goals[0, 1]) < float(below[0, 1])

"""The retreat as a node of the whole graph: lift, over the home, down; the box is not touched."""

import pytest
import torch

from deepkoco.engines.boxpush import world
from deepkoco.engines.boxpush.retreat import home_angles
from deepkoco.envs.boxpush import BoxPushOptions, box_push_graph, box_push_start
from deepkoco.envs.boxpush import homing as homing_module
from deepkoco.envs.boxpush.homing import ArmState, Homing, HomingError
from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.systems.boxpush import TOOL_HEIGHT, solve_joints, tool_pose

pytest.importorskip("mujoco")


def tensor(rows) -> torch.Tensor:
    return torch.tensor(rows, dtype=torch.float64)


PLACES = tensor([[0.45, 0.25, TOOL_HEIGHT], [0.30, -0.20, TOOL_HEIGHT]])
BOXES = tensor([[0.38, 0.20, 0.3], [0.37, -0.20, 0.0]])


def arm() -> ArmState:
    angles = solve_joints(home_angles()[1:].expand(2, 6), PLACES)
    return ArmState(angles, torch.zeros_like(angles), angles)


def test_arms_come_home_with_their_tools_down():
    put = tensor([[0.35, 0.0, 0.1]] * 2)
    home = Homing(BoxPushOptions()).run(arm(), BOXES, put)
    place = tool_pose(home.angles).place
    assert (home.angles - home_angles()[1]).abs().max() < 0.06
    assert (place[:, 2] - TOOL_HEIGHT).abs().max() < 0.03
    assert home.speeds.abs().max() < 1.0


def test_the_agent_is_not_heard_and_the_box_stays_while_the_tool_is_lifted_and_carried_over():
    graph = box_push_graph()
    timing = draw_timing(graph, torch.Generator().manual_seed(0), 30, 1)
    runtime = BatchedRuntime(graph, timing)
    now = arm()
    start = box_push_start(graph, BOXES, BOXES[:, :2], now.angles, goals=now.goals)
    start["retreat"]["active"] = torch.ones(2, dtype=torch.bool)
    rows = torch.zeros(2, dtype=torch.int64).numpy()
    state, _ = runtime.reset({}, torch.Generator().manual_seed(0), start, rows=rows)
    heights = []
    for _ in range(30):
        state, _ = runtime.step(state, torch.ones(2, 2, dtype=torch.float64))
        seen = world.box_state(state.nodes["world"]["seen"])
        heights.append(tool_pose(seen.angles).place[:, 2])
    assert (torch.stack(heights).amax(0) > 0.12).all()
    torch.testing.assert_close(seen.place[:, :2], BOXES[:, :2], atol=2e-3, rtol=0.0)
    assert (state.nodes["retreat"]["stage"] >= 2).all()


def test_an_arm_that_does_not_come_home_is_an_error(monkeypatch):
    monkeypatch.setattr(homing_module, "LONGEST", 0.5)
    with pytest.raises(HomingError, match=r"environment 0 is not home after 0\.5 s"):
        Homing(BoxPushOptions()).run(arm(), BOXES, BOXES)

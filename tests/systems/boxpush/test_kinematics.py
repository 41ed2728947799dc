"""The kinematics of the arm: against MuJoCo and by hand; joint angles for places; the picture."""

import numpy as np
import pytest
import torch

from deepkoco.systems.boxpush import (
    HOME,
    JOINTS,
    TOOL_HEIGHT,
    box_push_model,
    solve_joints,
    tool_pose,
    tool_step,
)
from deepkoco.systems.boxpush.arm import TOOL
from deepkoco.systems.boxpush.picture import GOAL, LID, draw_box_push

mujoco = pytest.importorskip("mujoco")
NEAR = torch.tensor([[0.0, -0.2, 0.9, 0.0, 0.8, 0.0]], dtype=torch.float64)


def test_at_zero_angles_the_tool_is_ahead_of_the_elbow():
    """Up by 0.07 + 0.057 + 0.3, ahead by 0.06 + 0.2 + 0.1 + 0.07 + the tool."""
    pose = tool_pose(torch.zeros(1, 6, dtype=torch.float64))
    np.testing.assert_allclose(pose.place[0], [0.43 + TOOL, 0.0, 0.427], atol=1e-12)
    np.testing.assert_allclose(pose.axis[0], [1.0, 0.0, 0.0], atol=1e-12)


def test_kinematics_are_those_of_the_model_in_mujoco():
    model = mujoco.MjModel.from_xml_string(box_push_model())
    state, body = mujoco.MjData(model), model.body("wrist_rotate").id
    drawn = np.random.default_rng(0).uniform([j.low for j in JOINTS], [j.high for j in JOINTS], (8, 6))
    pose = tool_pose(torch.from_numpy(drawn))
    for k, angles in enumerate(drawn):
        state.qpos[7:] = angles
        mujoco.mj_forward(model, state)
        axis = state.xmat[body].reshape(3, 3)[:, 0]
        tip = state.xpos[body] + TOOL * axis
        moves, turns = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, state, moves, turns, tip, body)
        for ours, theirs in zip(
            (p[k] for p in pose[:4]), (tip, axis, moves[:, 6:], turns[:, 6:]), strict=True
        ):
            np.testing.assert_allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize(
    "place", [(*HOME, TOOL_HEIGHT), (0.48, 0.28, TOOL_HEIGHT), (0.15, -0.28, TOOL_HEIGHT), (0.3, 0.1, 0.2)]
)
def test_joint_angles_put_the_tool_where_it_is_wanted_pointing_down(place: tuple[float, float, float]):
    wanted = torch.tensor([place], dtype=torch.float64)
    pose = tool_pose(solve_joints(NEAR, wanted))
    np.testing.assert_allclose(pose.place, wanted, atol=1e-6)
    np.testing.assert_allclose(pose.axis[0], [0.0, 0.0, -1.0], atol=1e-6)


def test_a_place_out_of_reach_leaves_finite_angles_as_near_as_the_arm_gets():
    far = torch.tensor([[1.5, 0.0, 0.1]], dtype=torch.float64)
    angles = solve_joints(NEAR, far, 200)
    assert torch.isfinite(angles).all()
    assert 0.5 < float(tool_pose(angles).place[0, 0]) < 0.8


def test_a_step_is_small_where_the_arm_is_stretched():
    """At full stretch the tool cannot move outwards along the arm; without damping the step would have no bound."""
    angles = torch.zeros(1, 6, dtype=torch.float64)
    angles[:, 1], angles[:, 2] = 1.0, -np.pi / 2 + np.arctan2(0.06, 0.3)
    forearm = angles[:, 1] + angles[:, 2]
    angles[:, 4] = np.pi / 2 - forearm
    outwards = torch.stack([torch.cos(forearm), 0.0 * forearm, -torch.sin(forearm)], -1)
    pose = tool_pose(angles)
    assert float(tool_step(angles, pose.place + 0.01 * outwards).abs().max()) < 0.1
    assert float(tool_step(angles, pose.place - 0.01 * outwards.flip(-1)).abs().max()) > 0.01


def test_the_picture_shows_box_and_goal():
    picture = draw_box_push(NEAR[0].numpy(), np.array([0.35, 0.1, 0.04]), 0.3, np.array([0.45, -0.1]), 128)
    assert picture.shape == (128, 128, 3)
    for colour in (LID, GOAL):
        assert (picture == np.array(colour)).all(-1).sum() > 20

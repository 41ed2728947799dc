"""From observations to the start of a model: what the graph was at the time of the picture."""

from typing import Any

import numpy as np
import pytest
import torch

from deepkoco.engines.boxpush.world import BoxState, box_state
from deepkoco.envs.boxpush import BoxPushOptions, box_push_graph
from deepkoco.envs.boxpush.boxpush_env import BoxPushVectorEnv
from deepkoco.envs.boxpush.model_start import ModelStart
from deepkoco.envs.graph_rollouts import GraphRollouts
from deepkoco.graph import Input
from deepkoco.systems.boxpush import tool_pose

pytest.importorskip("mujoco")
ACTIONS = np.array([[1.0, 0.0]] * 8 + [[0.5, 0.5]] * 4)
DELAYS: dict[str, Any] = {"camera_delay": 0.15, "actuation_delay": 0.03}


def message(data: torch.Tensor) -> Input:
    zero = torch.zeros(len(data), 1, dtype=torch.float64)
    return Input(
        data[:, None], zero.long(), zero - 9.0, zero - 9.0, torch.zeros(len(data), dtype=torch.float64)
    )


def driven(steps: int, take: str = "past"):
    """An environment after some actions, and what is known there; the world has no noise and constant delays."""
    envs = BoxPushVectorEnv(2, 50, noise=False, friction=None, **DELAYS)
    graph = box_push_graph(BoxPushOptions(noise=False, history=0, **DELAYS))
    start = ModelStart(graph, 10.0, take)
    options = {"box": [[0.33, 0.0, 0.1], [0.34, 0.05, 0.0]], "goal": [[0.48, 0.05], [0.45, 0.15]]}
    observation, _ = envs.reset(seed=0, options=options)
    truths = []
    for action in ACTIONS[:steps]:
        start.see(observation)
        truths.append(envs.state.nodes["world"]["seen"].clone())
        start.act(action[None].repeat(2, 0))
        observation, *_ = envs.step(action[None].repeat(2, 0).astype(np.float32))
    start.see(observation)
    truths.append(envs.state.nodes["world"]["seen"].clone())
    return envs, graph, start, truths


def behind(physics: torch.Tensor, then: BoxState) -> float:
    """How far the tool of a start is from where it was [m]."""
    places = [tool_pose(angles).place for angles in (physics[:, 8:14], then.angles)]
    return float((places[0] - places[1]).norm(dim=-1).max())


def test_the_start_lies_two_steps_back():
    _, _, start, truths = driven(10)
    ((which, states, past),) = start.groups()
    np.testing.assert_array_equal(which, [0, 1])
    np.testing.assert_array_equal(past, ACTIONS[None, 8:10].repeat(2, 0))
    then = box_state(truths[-3])
    physics = states["world"]["physics"]
    torch.testing.assert_close(physics[:, 1:3], then.place[:, :2], atol=1e-6, rtol=0.0)
    assert behind(physics, then) < 0.005
    np.testing.assert_allclose(states["agent"]["first"], ACTIONS[7:8].repeat(2, 0))


def test_the_tick_of_the_start_leads_to_the_goals_that_were_seen():
    _, graph, start, _ = driven(10)
    ((_, states, _),) = start.groups()
    node, first = graph.node("motion"), states["agent"]["first"]
    assert float(first.abs().max()) > 0.0
    _, goals = node.step({}, states["motion"], {"command": message(first)}, dt=1.0 / float(node.rate))
    # A step of damped least squares also levels the tool a little; where it is sent to along the table is the same.
    wanted, led = (tool_pose(angles).place[:, :2] for angles in (states["guard"]["goals"], goals))
    torch.testing.assert_close(led, wanted, atol=1e-4, rtol=0.0)


@pytest.mark.parametrize(("take", "back"), [("newest", 0), ("one instant", 2)])
def test_who_knows_no_delay_takes_the_picture_for_the_present(take: str, back: int):
    _, _, start, truths = driven(10, take)
    ((_, states, past),) = start.groups()
    assert past.shape == (2, 0, 2)
    physics = states["world"]["physics"]
    torch.testing.assert_close(physics[:, 1:3], box_state(truths[-3]).place[:, :2], atol=1e-6, rtol=0.0)
    # The newest angles are a tick old, and who knows no delay does not know that: 1 cm at 0.2 m/s.
    low, high = (0.0, 0.005) if back else (0.006, 0.015)
    assert low <= behind(physics, box_state(truths[-1 - back])) < high


def test_at_the_beginning_there_is_no_past():
    _, _, start, _ = driven(0)
    ((_, _, past),) = start.groups()
    assert past.shape == (2, 0, 2)


def test_the_model_with_delays_foretells_what_comes_and_without_it_does_not():
    """Rewards of the next six steps, of the model and of the environment, whose delays are those of the model."""
    errors = {}
    for take, delays in (("past", True), ("newest", False)):
        envs, graph, start, _ = driven(8, take)
        plan = ACTIONS[8:]
        ((_, states, past),) = start.groups()
        told = GraphRollouts(graph, 10, delays=delays).costs(states, past, plan[None, None].repeat(2, 0))
        paid = sum(-envs.step(action[None].repeat(2, 0).astype(np.float32))[1] for action in plan)
        errors[take] = np.abs(told[:, 0] - paid).max() / len(plan)
    assert errors["past"] < 0.01
    assert errors["newest"] > 2.0 * errors["past"]


def test_a_wrong_choice_is_refused():
    with pytest.raises(ValueError, match="one instant"):
        ModelStart(box_push_graph(), 10.0, "future")

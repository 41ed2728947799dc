"""Actions of the wrong shape are refused: reshaped, they would be the actions of other environments."""

import gymnasium
import numpy as np
import pytest
import torch
from counting import OBSERVATIONS, counting_graph
from gymnasium import spaces

from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper


def arms(count: int) -> DelayGraphVectorEnv:
    return DelayGraphVectorEnv(count, system="two_link_arm", task="manipulator")


BATCHES = {
    "graph": lambda: arms(3),
    "wrapper": lambda: VectorDelayWrapper(arms(3), 0.03),
}


@pytest.mark.parametrize("name", sorted(BATCHES))
@pytest.mark.parametrize("shape", [(2, 3), (6,), (1, 3, 2), (3,), (3, 1), (2,), ()])
def test_a_vector_environment_refuses_actions_of_another_shape(name: str, shape: tuple[int, ...]):
    env = BATCHES[name]()
    env.reset(seed=0)
    with pytest.raises(
        ValueError, match=r"have shape .*; give shape \(3, 2\): .* each of the 3 environments"
    ):
        env.step(np.zeros(shape, np.float32))
    env.step(np.zeros((3, 2), np.float32))


@pytest.mark.parametrize("kind", ["graph", "wrapper"])
@pytest.mark.parametrize("shape", [(1, 2), (2, 1), (4,), (1,), ()])
def test_a_single_environment_refuses_an_action_of_another_shape(kind: str, shape: tuple[int, ...]):
    env = DelayGraphEnv(system="two_link_arm", task="manipulator")
    env = DelayWrapper(env, 0.03) if kind == "wrapper" else env
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"the action has shape .*; give shape \(2,\)"):
        env.step(np.zeros(shape, np.float32))
    env.step(np.zeros(2, np.float32))


def test_lists_and_tensors_are_taken_as_arrays():
    env, other = arms(3), arms(3)
    env.reset(seed=0)
    other.reset(seed=0)
    actions = [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]
    assert np.array_equal(env.step(actions)[0], other.step(torch.tensor(actions, dtype=torch.float64))[0])


def test_an_action_space_may_have_another_shape_than_the_supervisors_output():
    env = GraphVectorEnv(
        4, counting_graph(), spaces.Discrete(2), OBSERVATIONS, 9, {"counter": {"stride": 1.0}}
    )
    env.reset(seed=0)
    observation, *_ = env.step(np.array([0, 1, 1, 0]))
    assert observation[:, 0].tolist() == [0.0, 1.0, 1.0, 0.0]
    with pytest.raises(ValueError, match=r"give shape \(4,\)"):
        env.step(np.zeros((4, 1)))


def test_choices_reach_a_wrapped_environment():
    env = DelayWrapper(gymnasium.make("CartPole-v1"), 0.0, control_rate=50)
    env.reset(seed=0)
    assert env.step(1)[4]["applied_action"] == 1

"""Copies of used environments: deep copies and pickles go on bit for bit, each by itself."""

import copy
import pickle
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from counting import ACTIONS, OBSERVATIONS, counting_graph
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.distractors.state_wrapper import StateDistractors, VectorStateDistractors
from deepkoco.envs.engine_env import EngineEnv
from deepkoco.envs.graph_env import GraphEnv
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.pixels import Pixels, VectorPixels
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.unit import make_unit

RANDOM = {"law": "gaussian", "loc": 0.05, "scale": 0.02}
WAYS: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


class Lamp(gymnasium.Env):
    """Its picture is as bright as the sum of its actions; nothing but `render` shows it."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012
    observation_space = gymnasium.spaces.Box(0.0, 1.0, (1,))
    action_space = gymnasium.spaces.Box(0.0, 1.0, (1,))
    render_mode = "rgb_array"

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.level = 0.0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.level += 15.0 * float(action[0])
        return np.zeros(1, np.float32), 0.0, False, False, {}

    def render(self):
        return np.full((20, 20, 3), int(self.level), np.uint8)


def counting_envs(executor: str) -> GraphVectorEnv:
    strides = {"counter": {"stride": torch.tensor([1.0, 2.0, 0.3, 0.7, 3.0], dtype=torch.float64)}}
    return GraphVectorEnv(
        5, counting_graph(RANDOM), ACTIONS, OBSERVATIONS, 6, strides, delay_traces=3, executor=executor
    )


def pendulums(count: int) -> Any:
    return gymnasium.make_vec(
        "deepkoco/RodPendulumDelay-v0", count, vectorization_mode="vector_entry_point", sensing_delay=RANDOM
    )


def pendulum() -> Any:
    return gymnasium.make("deepkoco/RodPendulumDelay-v0", sensing_delay=RANDOM)


ENVIRONMENTS: dict[str, Callable[[], Any]] = {
    "graph, compiled": lambda: counting_envs("fused"),
    "graph, eager": lambda: counting_envs("eager"),
    "graph, single": lambda: GraphEnv(
        counting_graph(RANDOM), ACTIONS, OBSERVATIONS, parameters={"counter": {"stride": 0.1}}
    ),
    "registered": pendulum,
    "registered, vector": lambda: pendulums(3),
    "parameters drawn": lambda: DelayGraphVectorEnv(
        20, 6, system="rod_pendulum", randomize={"mass": (0.8, 1.2), "actuation_delay": (0.0, 0.05)}
    ),
    "wrapped": lambda: DelayWrapper(
        gymnasium.make("Pendulum-v1"), 0.03, RANDOM, action_history=2, sensor_rate=60
    ),
    "wrapped, vector": lambda: VectorDelayWrapper(pendulums(3), 0.03, RANDOM, action_history=2),
    "distractors": lambda: StateDistractors(pendulum(), "copies+noise"),
    "distractors, vector": lambda: VectorStateDistractors(pendulums(3), "copies+noise"),
    "pixels": lambda: Pixels(pendulum(), size=16),
    "pixels, rendered": lambda: Pixels(Lamp(), size=16),
    "pixels, rendered, vector": lambda: VectorPixels(
        SyncVectorEnv([Lamp] * 2, autoreset_mode=AutoresetMode.DISABLED), size=16
    ),
    "pixels, vector": lambda: VectorPixels(pendulums(2), size=16),
    "equations": lambda: EngineEnv(sensing_delay=RANDOM),
    "unit in virtual time": lambda: UnitEnv(make_unit("rod_pendulum", seed=0), clock="simulated"),
}


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        one, other = list(one.values()), list(other.values())
    if isinstance(one, (list, tuple)):
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
        return
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype == object:
        assert_same(one.tolist(), other.tolist())
    elif one.dtype.kind != "U":
        assert one.dtype == other.dtype
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("way", sorted(WAYS))
@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_a_copy_of_a_used_environment_goes_on_bit_for_bit(name: str, way: str):
    env = ENVIRONMENTS[name]()
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(14)]
    env.reset(seed=3)
    for action in actions[:4]:
        env.step(action)
    other = WAYS[way](env)
    # The copy first, all of it: it must leave the original alone.
    ahead = [other.step(action) for action in actions[4:]] + [other.reset(), other.step(actions[0])]
    after = [env.step(action) for action in actions[4:]] + [env.reset(), env.step(actions[0])]
    for one, two in zip(after, ahead, strict=True):
        assert_same(one, two)
    env.close()
    other.close()


def test_a_copy_of_a_compiled_environment_is_compiled():
    env = counting_envs("fused")
    env.reset(seed=0)
    if env.executor != "fused":
        pytest.skip("no C++ compiler")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        other = pickle.loads(pickle.dumps(env))
        other.step(np.ones((5, 1)))
    assert other.executor == "fused"
    assert type(other.state) is type(env.state)


def test_a_part_of_a_copied_batch_starts_anew():
    env = counting_envs("fused")
    env.reset(seed=0)
    env.step(np.ones((5, 1)))
    other = copy.deepcopy(env)
    mask = np.array([True, False, False, True, False])
    assert_same(env.reset(options={"reset_mask": mask}), other.reset(options={"reset_mask": mask}))
    for _ in range(8):
        assert_same(env.step(np.ones((5, 1))), other.step(np.ones((5, 1))))


def test_a_copy_grows_beyond_its_first_delays():
    env = DelayGraphEnv(system="rod_pendulum", sensing_delay=RANDOM)
    env.batch.plan_episodes(5)
    env.reset(seed=0)
    env.step(np.array([0.3], np.float32))
    other = copy.deepcopy(env)
    for k in range(12):
        action = np.array([np.sin(k)], np.float32)
        assert_same(env.step(action), other.step(action))


@pytest.mark.parametrize("way", sorted(WAYS))
@pytest.mark.parametrize("name", ["rod_pendulum", "pendulum"])
def test_a_copy_of_a_mujoco_environment_goes_on_bit_for_bit(name: str, way: str):
    pytest.importorskip("mujoco")
    env = EngineEnv(name, "mujoco")
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (8, 1)).astype(np.float32)
    for action in actions[:3]:
        env.step(action)
    other = WAYS[way](env)
    ahead = [other.step(action) for action in actions[3:]] + [other.reset()]
    after = [env.step(action) for action in actions[3:]] + [env.reset()]
    for one, two in zip(after, ahead, strict=True):
        assert_same(one, two)


def test_environments_live_in_processes_of_their_own():
    """Gymnasium hands each process a pickled maker; a used environment in it is a pickle as well."""
    used = DelayGraphEnv(system="rod_pendulum", sensing_delay=RANDOM)
    used.reset(seed=1)
    used.step(np.array([0.5], np.float32))
    # One process shows it; each further one takes seconds to start.
    envs = AsyncVectorEnv([lambda: copy.deepcopy(used)], context="spawn")
    try:
        observation, _ = envs.reset(seed=[4])
        assert_same(used.reset(seed=4)[0], observation[0])
    finally:
        envs.close()


def test_what_runs_in_real_time_says_that_it_cannot_be_copied():
    env = UnitEnv(make_unit("rod_pendulum", seed=0))
    env.reset(seed=0)
    try:
        with pytest.raises(TypeError, match="runs in real time: it cannot be copied"):
            copy.deepcopy(env)
    finally:
        env.close()

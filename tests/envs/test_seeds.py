"""A seed for each environment, as in Gymnasium's own vector form."""

import gymnasium
import numpy as np
import pytest
from counting import ACTIONS, OBSERVATIONS, counting_graph
from gymnasium.vector import SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.distractors.state_wrapper import VectorStateDistractors
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.pixels import VectorPixels
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper

RANDOM = {"law": "gaussian", "loc": 0.05, "scale": 0.02}
SETTINGS = {
    "constant": {},
    "random delays": {"sensing_delay": RANDOM, "actuation_delay": RANDOM},
    "all drawn": {"randomize": {"mass": (0.5, 2.0), "actuation_delay": (0.0, 0.1)}, "sensing_delay": RANDOM},
}
STEPS = 12


def batch(count: int, **options) -> DelayGraphVectorEnv:
    return DelayGraphVectorEnv(count, system="rod_pendulum", **options)


def alone(**options) -> DelayGraphEnv:
    return DelayGraphEnv(system="rod_pendulum", **options)


def episode(env, seeds, count: int) -> np.ndarray:
    actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, 1, 1)).astype(np.float32)
    seen = [env.reset(seed=seeds)[0]]
    seen += [env.step(np.repeat(action, count, 0))[0] for action in actions]
    return np.array(seen)


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_each_environment_has_the_episode_of_a_single_one_with_its_seed(name: str):
    seeds = [5, 0, 5, 123456789]
    together = episode(batch(4, **SETTINGS[name]), seeds, 4)
    apart = episode(SyncVectorEnv([lambda: alone(**SETTINGS[name])] * 4), seeds, 4)
    np.testing.assert_allclose(together, apart, rtol=1e-5, atol=1e-6)
    assert np.array_equal(together[:, 0], together[:, 2])
    assert not np.allclose(together[:, 0], together[:, 1])


@pytest.mark.parametrize("name", sorted(SETTINGS))
@settings(max_examples=8, deadline=None)
@given(seeds=st.lists(st.integers(0, 2**31), min_size=3, max_size=3, unique=True), place=st.integers(0, 2))
def test_an_environments_episode_does_not_depend_on_the_seeds_of_others(name, seeds, place):
    others = [seed + 1 if b != place else seed for b, seed in enumerate(seeds)]
    env = batch(3, **SETTINGS[name])
    first, second = (episode(env, own, 3) for own in (seeds, others))
    assert np.array_equal(first[:, place], second[:, place])


def test_none_goes_on_with_the_draws_of_before():
    seeds = [7, None, 3]
    env, other, further = (batch(3, **SETTINGS["all drawn"]) for _ in range(3))
    for one in (env, other):
        one.reset(seed=1)
    further.reset(seed=2)
    first, again, third = (episode(one, seeds, 3) for one in (env, other, further))
    assert np.array_equal(first, again)
    assert np.array_equal(first[:, [0, 2]], third[:, [0, 2]])
    assert not np.allclose(first[:, 1], third[:, 1])


def test_a_list_of_none_is_no_seed():
    env, other = batch(2), batch(2)
    for one in (env, other):
        one.reset(seed=1)
    assert np.array_equal(env.reset(seed=[None, None])[0], other.reset()[0])


def test_episodes_after_the_first_follow_from_all_seeds():
    def later(seeds):
        env = batch(3, max_episode_steps=4, **SETTINGS["all drawn"])
        return episode(env, seeds, 3)[6:]

    assert np.array_equal(later([1, 2, 3]), later([1, 2, 3]))
    assert not np.allclose(later([1, 2, 3]), later([1, 2, 4]))


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_seeds_of_those_in_the_mask_count(name: str):
    mask = np.array([True, False, True])
    runs = []
    for seeds in ([4, 9, 6], [4, None, 6]):
        env = batch(3, **SETTINGS[name])
        env.reset(seed=0)
        before = env.step(np.zeros((3, 1)))[0]
        after, _ = env.reset(seed=seeds, options={"reset_mask": mask})
        assert np.array_equal(after[1], before[1])
        runs.append([after] + [env.step(np.full((3, 1), 0.3))[0] for _ in range(5)])
    assert np.array_equal(*runs)
    if name == "constant":  # else the delays are those of a schedule that is there already
        assert np.allclose(runs[0][0][0], alone().reset(seed=4)[0])


def test_more_seeds_than_delay_traces_share_them():
    env = batch(9, delay_traces=4, **SETTINGS["random delays"])
    seeds = [*range(8), 0]
    first = episode(env, seeds, 9)
    assert len(env.state.schedule.timing.boundary) <= 8
    assert np.array_equal(first[:, 0], first[:, 8])
    assert np.array_equal(first, episode(env, seeds, 9))


def test_nodes_that_draw_their_own_state_follow_the_seeds():
    env = GraphVectorEnv(
        3, counting_graph(RANDOM), ACTIONS, OBSERVATIONS, 9, randomize={"counter.stride": (0.1, 0.5)}
    )
    env.reset(seed=[1, 2, 1])
    drawn = env.drawn["counter.stride"]
    assert drawn[0] == drawn[2] != drawn[1]


def test_a_wrapped_vector_environment_takes_a_seed_for_each():
    seeds = [3, 8, 3]
    together = VectorDelayWrapper(batch(3), RANDOM, RANDOM)
    apart = SyncVectorEnv([lambda: DelayWrapper(alone(), RANDOM, RANDOM)] * 3)
    np.testing.assert_allclose(episode(together, seeds, 3), episode(apart, seeds, 3), rtol=1e-5, atol=1e-6)
    assert np.array_equal(episode(together, [3, None, 8], 3)[:, 0], episode(together, seeds, 3)[:, 0])


@pytest.mark.parametrize(
    "wrap", [lambda env: VectorPixels(env, size=8), lambda env: VectorStateDistractors(env, "noise")]
)
def test_other_wrappers_take_lists_with_none(wrap):
    env = wrap(batch(2))
    first, _ = env.reset(seed=[1, 2])
    assert np.array_equal(env.reset(seed=[1, 2])[0], first)
    env.reset(seed=[1, None])


def test_a_list_of_another_length_is_refused():
    for env in (batch(3), VectorDelayWrapper(batch(3), 0.01)):
        with pytest.raises(ValueError, match="2 seeds for 3 environments"):
            env.reset(seed=[1, 2])
        with pytest.raises(TypeError):
            env.reset(seed=[1, 2, "three"])


def test_registered_environments_take_a_seed_for_each():
    envs = gymnasium.make_vec("deepkoco/RodPendulum-v0", 2, vectorization_mode="vector_entry_point")
    observation, _ = envs.reset(seed=[11, 12])
    single = gymnasium.make("deepkoco/RodPendulum-v0")
    np.testing.assert_allclose(observation[1], single.reset(seed=12)[0], rtol=1e-6)

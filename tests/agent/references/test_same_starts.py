"""Start states of the final evaluation, for environments seeded one by one and for those seeded together."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv

from deepkoco.agent.collection import episode_costs
from deepkoco.agent.references.same_starts import SameStarts


class Still:
    def __init__(self, count: int) -> None:
        self.count = count

    def reset(self) -> None:
        pass

    def act(self, observations) -> np.ndarray:
        assert len(observations) == self.count
        return np.zeros((self.count, 1))


def one_by_one(count: int) -> VectorEnv:
    return gymnasium.make_vec("Pendulum-v1", num_envs=count, vectorization_mode="sync", max_episode_steps=5)


class Together(VectorEnv):
    """Draws all start states at once, so they depend on how many there are; a step costs the distance from 0."""

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, count: int) -> None:
        self.num_envs = count
        self.single_observation_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        self.state = np.random.default_rng(seed).uniform(-1, 1, (2, self.num_envs)).T.astype(np.float32)
        return self.state, {}

    def step(self, actions):
        ended = np.ones(self.num_envs, bool)
        return self.state, -np.abs(self.state).sum(1), ended, ~ended, {}


@pytest.mark.parametrize(("make", "batch"), [(one_by_one, 2), (Together, 6)])
def test_the_first_start_states_of_the_evaluation_in_as_few_environments_as_show_them(make, batch):
    made = {}

    def envs(count):
        return made.setdefault(count, make(count))

    starts = SameStarts(envs, 6, 2, seed=11)
    few = starts.run(Still)
    everything = SameStarts(envs, 6, 6, seed=11).run(Still)
    assert starts._envs.num_envs == batch
    assert len(few) == 2
    np.testing.assert_array_equal(few[0].observations[0], everything[0].observations[0])
    np.testing.assert_allclose(episode_costs(few), episode_costs(everything)[:2])


def test_no_more_start_states_than_the_evaluation_had():
    assert SameStarts(one_by_one, 3, 50, seed=0).count == 3

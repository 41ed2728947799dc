"""Actions with NaN or infinity are refused by every environment, which then goes on as if they had not been given."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from deepkoco.envs.actions import ActionError, check_finite_action
from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.dm_control import CostOfReward
from deepkoco.envs.engine_env import EngineEnv
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.unit import make_unit


class Adder(gymnasium.Env):
    """Observes the sum of its actions; 10 Hz."""

    dt = 0.1
    observation_space = gymnasium.spaces.Box(-1e4, 1e4, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.total = np.zeros(1, np.float32)
        return self.total.copy(), {}

    def step(self, action):
        self.total += action
        return self.total.copy(), 0.0, False, False, {}


ENVIRONMENTS = {
    "graph": lambda: DelayGraphEnv(system="rod_pendulum"),
    "graph, two commands": lambda: DelayGraphEnv(system="two_link_arm", task="manipulator"),
    "graph, batch": lambda: DelayGraphVectorEnv(3, system="rod_pendulum"),
    "engine": lambda: EngineEnv(longest_episode=10),
    "unit": lambda: UnitEnv(make_unit("rod_pendulum"), clock="simulated"),
    "wrapper": lambda: DelayWrapper(Adder(), actuation_delay=0.15, action_history=2),
    "wrapper, batch": lambda: VectorDelayWrapper(SyncVectorEnv([Adder] * 3), actuation_delay=0.15),
    "repeated": lambda: CostOfReward(Adder(), 2, 0.1),
}


def roll(env, refused=()):
    good = np.full(env.action_space.shape, 0.3, np.float32)
    seen = [env.reset(seed=1)[0]]
    for k in range(4):
        for bad in refused if k == 2 else ():
            with pytest.raises(
                ActionError, match=r"^action.* is (nan|inf); an actuator needs a finite number"
            ):
                env.step(bad)
        seen.append(env.step(good)[0])
    env.close()
    return np.array(seen)


@pytest.mark.parametrize("kind", ENVIRONMENTS)
def test_an_environment_refuses_an_action_that_is_not_finite_and_goes_on_without_it(kind):
    env = ENVIRONMENTS[kind]()
    wrong = [np.full(env.action_space.shape, 0.3, np.float32) for _ in range(2)]
    wrong[0].flat[-1], wrong[1].flat[0] = np.nan, np.inf
    np.testing.assert_array_equal(roll(env, wrong), roll(ENVIRONMENTS[kind]()))


def test_the_error_names_the_environment_of_a_batch_and_the_entry():
    actions = np.zeros((4, 2), np.float32)
    actions[2, 1] = np.nan
    with pytest.raises(ActionError, match=r"^action of environment 2 entry \[1\] is nan"):
        check_finite_action(actions, batched=True)


@given(
    action=arrays(np.float32, array_shapes(max_dims=2, max_side=4), elements=st.floats(width=32)),
    batched=st.booleans(),
)
def test_check_finite_action_refuses_exactly_nan_and_infinity(action, batched):
    if np.isfinite(action).all():
        check_finite_action(action, batched)
    else:
        with pytest.raises(ActionError):
            check_finite_action(action, batched)

"""Rollouts of a policy: those that an environment takes ahead are those of its steps, in every way of starting anew."""

from dataclasses import fields

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from test_graph_env import together

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.actions import ActionError
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.rollouts import PolicyRollouts, Rollout
from deepkoco.graph import Connection, Graph, Node, Supervisor

MODES = list(AutoresetMode)


def push(parameters, seen):
    """Three quarters forward, less where the count is high, and noise."""
    return parameters["gain"] - 0.02 * seen["observation"][:, :1] + seen["noise"]


def play(make, ahead, steps=(23, 40), gain=0.75, scale=0.3, batch=4):
    """Several rollouts, one behind the other."""
    rollouts = PolicyRollouts(make(), ahead)
    assert rollouts.ahead == ahead
    rollouts.start(5)
    generator = torch.Generator().manual_seed(0)
    return [
        rollouts.run(
            push,
            n,
            {"gain": torch.tensor(gain)},
            {"noise": scale * torch.randn(n, batch, 1, generator=generator)},
        )
        for n in steps
    ]


def assert_same(found: list[Rollout], expected: list[Rollout], tolerance: float) -> None:
    for own, other in zip(found, expected, strict=True):
        for field in fields(Rollout):
            values = getattr(own, field.name), getattr(other, field.name)
            assert values[0].dtype == values[1].dtype, field.name
            np.testing.assert_allclose(*values, rtol=tolerance, atol=tolerance, err_msg=field.name)


@pytest.mark.filterwarnings("error:.*runs between steps")
@pytest.mark.parametrize("executor", ["fused", "eager"])
@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
def test_steps_ahead_are_those_of_one_by_one(mode, executor):
    found = play(lambda: together(mode, executor=executor), True)
    assert_same(found, play(lambda: together(mode), False), 1e-5)
    ends = np.concatenate([own.ended for own in found])
    assert len(np.unique(ends.sum(0))) > 1  # environments end at different times
    vain = np.concatenate([own.vain for own in found])
    assert vain.sum() == (ends[:-1].sum() if mode == AutoresetMode.NEXT_STEP else 0)


@pytest.mark.parametrize("units", ["normalized", "physical"])
def test_random_delays_and_clipped_commands_are_the_same(units):
    def make():
        return gymnasium.make_vec(
            "deepkoco/RodPendulumDelay-v0", 6, vectorization_mode="vector_entry_point", max_episode_steps=15,
            actuation_delay={"law": "gaussian", "loc": 0.02, "scale": 0.005}, action_history=2, action_units=units,
            randomize={"mass": (0.8, 1.2), "sensing_delay": (0.0, 0.06)},
        )  # fmt: skip

    runs = [play(make, ahead, scale=3.0, batch=6) for ahead in (True, False)]
    assert_same(*runs, 1e-4)
    # The last commands, at their limits, are part of what is observed.
    limit = 1.0 if units == "normalized" else 2.0
    assert (abs(runs[0][0].observations[..., 3]) == limit).any()


def test_each_step_leads_to_the_next_or_ends_an_episode():
    (rollout,) = play(lambda: together(AutoresetMode.SAME_STEP), True, steps=(40,))
    goes_on = ~rollout.ended[:-1]
    np.testing.assert_array_equal(rollout.following[:-1][goes_on], rollout.observations[1:][goes_on])
    np.testing.assert_array_equal(rollout.observations[1:][~goes_on], 0.0)
    assert (rollout.following[rollout.terminated][:, 0] >= 5.0).all()


def test_what_a_wrapper_does_to_a_step_is_not_passed_by():
    class Doubled(gymnasium.vector.VectorWrapper):
        def step(self, actions):
            observation, reward, *rest = self.env.step(actions)
            return observation, 2 * reward, *rest

    rollouts = PolicyRollouts(Doubled(together()))
    assert not rollouts.ahead
    rollouts.start(5)
    noise = {"noise": torch.zeros(6, 4, 1)}
    once = PolicyRollouts(together())
    once.start(5)
    found, expected = (own.run(push, 6, {"gain": torch.tensor(0.75)}, noise) for own in (rollouts, once))
    np.testing.assert_allclose(found.rewards, 2 * expected.rewards, rtol=1e-5)


def test_any_vector_environment_of_gymnasium_is_stepped():
    envs = gymnasium.make_vec("Pendulum-v1", 3, vectorization_mode="sync")
    rollouts = PolicyRollouts(envs)
    rollouts.start(0)
    rollout = rollouts.run(push, 205, {"gain": torch.tensor(0.0)}, {"noise": torch.randn(205, 3, 1)})
    assert rollout.observations.shape == rollout.following.shape == (205, 3, 3)
    np.testing.assert_array_equal(np.flatnonzero(rollout.truncated.all(1)), [199])
    np.testing.assert_array_equal(np.flatnonzero(rollout.vain.all(1)), [200])


def test_an_action_that_is_no_number_is_refused():
    rollouts = PolicyRollouts(together())
    rollouts.start(0)
    with pytest.raises(ActionError, match="is nan"):
        rollouts.run(push, 3, {"gain": torch.tensor(float("nan"))}, {"noise": torch.zeros(3, 4, 1)})


@pytest.mark.parametrize("ahead", [False, True])
def test_an_infinite_action_is_refused_either_way(ahead):
    envs = gymnasium.make_vec(
        "deepkoco/RodPendulumDelay-v0", num_envs=8, vectorization_mode="vector_entry_point"
    )
    rollouts = PolicyRollouts(envs, ahead)
    rollouts.start(0)
    with pytest.raises(ActionError):
        rollouts.run(lambda parameters, seen: seen["observation"][:, :1] * 0 + float("inf"), 3)


class Engine(Node):
    """Counts its steps outside of the state, as an engine or a robot does."""

    pure = False

    def __init__(self):
        super().__init__("engine", 10)
        self.count = 0.0

    def init(self, parameters, generator, batch):
        self.count = 0.0
        return {}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1)

    def step(self, parameters, state, inputs):
        self.count += 1.0
        return state, torch.full((1, 1), self.count)


class UntilFive(Supervisor):
    inputs = ("engine",)

    def observe(self, parameters, state, inputs, action):
        count = inputs["engine"].data[:, -1]
        return state, {"observation": count, "reward": count[:, 0], "terminated": count[:, 0] >= 5.0}


def test_an_engine_is_never_driven_past_the_end_of_an_episode():
    found = []
    for ahead in (False, True):
        agent = UntilFive("agent", 10, initial_action=torch.zeros(1))
        graph = Graph([Engine(), agent], [Connection("engine", "agent")])
        box = gymnasium.spaces.Box(-np.inf, np.inf, (1,))
        envs = GraphVectorEnv(1, graph, gymnasium.spaces.Box(-1.0, 1.0, (1,)), box, 20)
        rollouts = PolicyRollouts(envs, ahead)
        rollouts.start(0)
        found.append(rollouts.run(lambda parameters, seen: seen["observation"] * 0, 14))
    assert np.array_equal(found[0].following, found[1].following)
    assert found[0].terminated.sum() > 1

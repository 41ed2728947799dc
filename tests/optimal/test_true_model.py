"""The true model is the environment, step by step."""

import gymnasium
import numpy as np
import pytest
import torch

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.distractors import VectorStateDistractors
from deepkoco.envs.sparse_cost import VectorSparseCost
from deepkoco.optimal import TrueModel, TrueModelError, play, start_states

IDS = ("deepkoco/RodPendulum-v0", "deepkoco/Pendulum-v0", "deepkoco/Manipulator-v0")


def make(name, count=3, **settings):
    mode = "vector_entry_point" if name.startswith("deepkoco") else "sync"
    return gymnasium.make_vec(name, num_envs=count, vectorization_mode=mode, **settings)


@pytest.mark.parametrize("name", IDS)
def test_states_and_costs_are_those_of_the_environment(name):
    envs = make(name, action_units="physical", executor="eager")
    model = TrueModel.of(envs)
    start = start_states(envs, seed=4)
    generator = torch.Generator().manual_seed(1)
    # Beyond the limits too: both cut.
    actions = 1.2 * model.high * (2 * torch.rand(25, 3, len(model.low), generator=generator).double() - 1)
    actions = actions.float().double()
    played = play(model, start, 25, lambda state, step: actions[step].clamp(model.low, model.high))
    for step, given in enumerate(actions):
        reward = envs.step(given.numpy().astype(np.float32))[1]
        np.testing.assert_allclose(-reward, played.costs[:, step], rtol=1e-6, atol=1e-9)
    truth = envs.unwrapped.state.nodes["agent"]["truth"]
    np.testing.assert_allclose(played.states[:, -1], truth, rtol=1e-9, atol=1e-9)


def test_a_delayed_input_starts_with_nothing_and_then_acts_on_the_state_that_is_there():
    model = TrueModel.of(make(IDS[0]))
    start = torch.tensor([[0.5, 0.0]], dtype=torch.float64)
    played = play(model, start, 3, lambda state, step: -state[:, :1], input_delay=True)
    torch.testing.assert_close(
        played.actions[0, :, 0], torch.cat([torch.zeros(1), -played.states[0, 1:3, 0]]).double()
    )


def test_distractors_leave_the_start_states_as_they_are():
    plain, disturbed = make(IDS[0]), VectorStateDistractors(make(IDS[0]), shuffle_seed=3)
    torch.testing.assert_close(start_states(plain, 7), start_states(disturbed, 7), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"actuation_delay": 0.02}, "delays"),
        ({"sensing_delay": 0.02}, "delays"),
        ({"randomize": {"mass": (0.9, 1.1)}}, "mass"),
    ],
)
def test_what_is_no_function_of_the_state_is_refused(settings, message):
    with pytest.raises(TrueModelError, match=message):
        TrueModel.of(make("deepkoco/RodPendulumDelay-v0", **settings))


def test_other_environments_are_refused():
    with pytest.raises(TrueModelError, match="does not tell"):
        TrueModel.of(make("Pendulum-v1"))


def test_a_cost_that_a_wrapper_replaces_is_refused():
    with pytest.raises(TrueModelError, match="VectorSparseCost"):
        TrueModel.of(VectorStateDistractors(VectorSparseCost(make(IDS[0]), 0.25), shuffle_seed=3))

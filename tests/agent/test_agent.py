"""Acting: input delay, realised increments, one robot and many."""

import numpy as np
import pytest
import torch

from deepkoco.agent import KoopmanPolicy, load_policy
from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.exploration import OrnsteinUhlenbeck
from deepkoco.agent.policy import ObservationError
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.files.model_folder import write_model_folder
from deepkoco.planning import PlannerConfig, make_planner

LOW, HIGH = np.array([-2.0]), np.array([2.0])
CONFIG = PlannerConfig(6)


def observations(steps: int, size: int = 3) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(steps, size))


def test_an_action_is_decided_one_step_before_it_is_applied(model):
    policy = KoopmanPolicy(model, CONFIG, LOW, HIGH)
    planner = make_planner(model, CONFIG, LOW, HIGH)
    expected = np.zeros(1)
    for o in observations(5):
        np.testing.assert_allclose(policy.act(o), expected, rtol=1e-6)
        expected = expected + planner.plan(*model.linearise(o, expected), expected)
    assert np.abs(expected).max() > 1e-3


def test_many_environments_act_as_one_by_one(model):
    agent = VectorAgent(model, CONFIG, LOW, HIGH, 3)
    policies = [KoopmanPolicy(model, CONFIG, LOW, HIGH) for _ in range(3)]
    for batch in observations(12).reshape(4, 3, 3):
        together = agent.act(batch)
        alone = np.stack([policy.act(o) for policy, o in zip(policies, batch, strict=True)])
        np.testing.assert_allclose(together, alone, atol=1e-6)
    assert agent.statistics.plans == 12


def test_noise_moves_the_increment_and_the_action_is_clipped():
    noise = OrnsteinUhlenbeck(2, 1, 0.85, 0.85, torch.Generator().manual_seed(3))
    twin = OrnsteinUhlenbeck(2, 1, 0.85, 0.85, torch.Generator().manual_seed(3))
    agent = VectorAgent(None, CONFIG, LOW, HIGH, 2, noise)
    expected = np.zeros((2, 1))
    for _ in range(30):
        np.testing.assert_allclose(agent.act(np.zeros((2, 3))), expected)
        expected = np.clip(expected + twin.step().numpy(), -2.0, 2.0)


def test_reset_starts_again_from_action_zero(model):
    policy = KoopmanPolicy(model, CONFIG, LOW, HIGH)
    first = [policy.act(o) for o in observations(4)]
    policy.reset()
    assert [policy.act(o) for o in observations(4)] == first
    assert first[0] == 0.0


def test_first_action_lies_inside_limits_that_exclude_zero(model):
    policy = KoopmanPolicy(model, CONFIG, np.array([0.5]), np.array([2.0]))
    assert policy.act(np.zeros(3)) == 0.5


def test_observations_that_are_not_finite_hold_the_plan_and_are_counted(model):
    policy = KoopmanPolicy(model, CONFIG, LOW, HIGH)
    policy.act(np.zeros(3))
    for _ in range(10):
        assert np.isfinite(policy.act([np.nan, 0.0, np.inf])).all()
    assert policy.statistics.failures == 10


def test_an_observation_of_the_wrong_size_is_named(model):
    with pytest.raises(ObservationError, match=r"\(4,\).*\(3,\)"):
        KoopmanPolicy(model, CONFIG, LOW, HIGH).act(np.zeros(4))


def test_observations_may_carry_further_entries_and_several_actions():
    torch.manual_seed(0)
    model = export_model(KoopmanModel(9, 2, ModelConfig(2, 0.05, (8,), (8,))))
    policy = KoopmanPolicy(model, CONFIG, np.full(2, -1.0), np.full(2, 1.0))
    for o in observations(3, 9):
        assert policy.act(o).shape == (2,)
    assert policy.statistics.failures == 0


def test_a_loaded_policy_acts_as_the_saved_one_and_takes_other_planner_settings(model, tmp_path):
    stored = {"planner": {"horizon": 6}, "action_low": [-2.0], "action_high": [2.0]}
    write_model_folder(model, tmp_path / "run" / "model", stored)
    policy, loaded = KoopmanPolicy(model, CONFIG, LOW, HIGH), load_policy(tmp_path / "run")
    osqp = load_policy(tmp_path / "run" / "model", solver="osqp", tolerance=1e-9)
    for o in observations(6):
        action = policy.act(o)
        assert loaded.act(o) == action
        np.testing.assert_allclose(osqp.act(o), action, atol=1e-4)

"""Plans against what came true, replays of the true system, and the pictures of a film."""

import gymnasium
import numpy as np
import pytest
import torch

import deepkoco.envs  # noqa: F401 - registers the tasks
from deepkoco.agent.policy import KoopmanPolicy
from deepkoco.analysis.measures.plans import draw_planned_costs, make_plan, planned_costs
from deepkoco.analysis.measures.replays import Future, ReplayError, film_episode, follow_plan
from deepkoco.analysis.page.plan_film import draw_shadows, make_film, shadow_steps, still_background
from deepkoco.envs.film import write_clip
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.planning import PlannerConfig, make_planner

LOW, HIGH = np.array([-2.0]), np.array([2.0])
PLANNER = PlannerConfig(horizon=4)


@pytest.fixture
def policy():
    torch.manual_seed(3)
    model = export_model(KoopmanModel(3, 1, ModelConfig(2, 0.05, (8,), (8,))))
    return KoopmanPolicy(model, PLANNER, LOW, HIGH)


def pendulum(steps=14):
    return gymnasium.make_vec(
        "deepkoco/RodPendulum-v0",
        num_envs=1,
        vectorization_mode="vector_entry_point",
        render_mode="rgb_array",
        max_episode_steps=steps,
        action_units="physical",
    )


def test_the_cost_of_a_plan_is_that_of_stepping_the_model_under_it(policy):
    model, action = policy.model, np.array([0.3])
    observation = np.array([0.5, -0.8, 1.0])
    plan = make_plan(model, make_planner(model, PLANNER, LOW, HIGH), 4, observation, action)
    assert plan.actions.shape == (4, 1)
    rows, factor = model.linearise(observation, action)
    latent, before = rows[0], action
    for planned, cost in zip(plan.actions, plan.costs[1:], strict=True):
        latent = model.dynamics.matrix @ latent + rows[1:].T @ (planned - before)
        before = planned
        expected = np.square(factor @ latent).sum() + model.action_weight * np.square(planned).sum()
        assert cost == pytest.approx(expected)


def test_a_plan_that_cannot_be_made_holds_the_action(policy):
    impossible = make_planner(policy.model, PLANNER, HIGH, LOW)
    plan = make_plan(policy.model, impossible, 4, np.array([0.5, -0.8, 1.0]), np.array([2.0]))
    assert impossible.statistics.failures == 1
    assert plan.costs.shape == (5,)
    np.testing.assert_array_equal(plan.actions[1:], np.repeat(plan.actions[:1], 3, axis=0))


def test_realised_costs_are_those_of_the_following_steps(exact):
    model, steps = exact
    found = planned_costs(model, PLANNER, np.array([-9.0]), np.array([9.0]), steps)
    assert len(found.planned) == (40 - 4) + (25 - 4)
    assert found.realised[7] == pytest.approx(steps.costs[8:12].sum())
    assert (found.episode[36], found.step[36]) == (1, 0)
    assert found.realised[36] == pytest.approx(steps.costs[41:45].sum())
    assert draw_planned_costs(found, 4, 0.1).table.shape == (57, 4)


def test_the_true_system_under_a_plan_starts_where_the_episode_was(policy):
    envs = pendulum()
    episode = film_episode(envs, policy, PLANNER, LOW, HIGH, seed=4, most=12)
    assert len(episode.costs) == len(episode.plans) == len(episode.frames) == 12
    # The first planned action is what the controller then did, so that step costs what was paid.
    for step in (0, 3, 7):
        np.testing.assert_allclose(episode.plans[step].actions[0], episode.actions[step + 1], atol=1e-6)
        future = follow_plan(envs, episode, step, pictures=(1, 4))
        assert future.costs[0] == pytest.approx(episode.costs[step + 1], rel=1e-5)
        assert len(future.costs) == 4
        np.testing.assert_array_equal(future.scenes[0], episode.scenes[step + 1])
    assert len(follow_plan(envs, episode, 11).costs) == 2  # the environment ends after 14 steps
    envs.close()


def test_an_environment_that_does_not_repeat_itself_is_told(policy):
    envs = pendulum()
    episode = film_episode(envs, policy, PLANNER, LOW, HIGH, seed=4, most=6)
    other = episode.__class__(**{**vars(episode), "seed": 5})
    with pytest.raises(ReplayError, match="seed 5 is not repeated"):
        follow_plan(envs, other, 2)
    envs.close()


def test_an_environment_that_cannot_be_drawn_is_told(policy):
    envs = gymnasium.make_vec("deepkoco/RodPendulum-v0", num_envs=1, vectorization_mode="vector_entry_point")
    with pytest.raises(ReplayError, match="cannot be drawn"), pytest.warns(UserWarning, match="render mode"):
        film_episode(envs, policy, PLANNER, LOW, HIGH, seed=4, most=6)


def square_at(place):
    scene = np.full((40, 40, 3), 250, np.uint8)
    scene[10:20, place : place + 8] = (20, 40, 200)
    return scene


def test_the_background_does_not_keep_what_rests_most_of_the_time():
    scenes = [square_at(20)] * 50 + [square_at(p) for p in (0, 4, 9, 30)]
    np.testing.assert_array_equal(still_background(scenes), np.full((40, 40, 3), 250.0))


def test_shadows_lie_where_things_will_be_and_fade():
    background = np.full((40, 40, 3), 250.0)
    frame = np.concatenate(
        [square_at(0), np.zeros((8, 40, 3), np.uint8)]
    )  # with a strip of distractors below
    drawn = draw_shadows(frame.copy(), square_at(0), [square_at(10), square_at(25)], background)
    np.testing.assert_array_equal(drawn[10:20, 0:8], frame[10:20, 0:8])  # the present stays as it is
    np.testing.assert_array_equal(drawn[40:], frame[40:])
    near, far, empty = (np.abs(drawn[15, c].astype(int) - 250).sum() for c in (12, 28, 36))
    assert near > far > 0
    assert empty == 0


def test_shadows_are_drawn_at_thirds_of_the_plan():
    assert shadow_steps(15) == [5, 10, 15]
    assert shadow_steps(1) == [1]


def test_a_film_can_be_played_and_tells_its_numbers(policy, tmp_path):
    envs = pendulum()
    episode = film_episode(envs, policy, PLANNER, LOW, HIGH, seed=4, most=8)
    futures = {k: follow_plan(envs, episode, k, shadow_steps(4)) for k in (0, 4)}
    envs.close()
    film = make_film(episode, futures, 0.05)
    assert film.rate == pytest.approx(5.0)  # four steps of 0.05 s from frame to frame
    assert len(film.frames) == 2
    assert film.frames[0].shape[0] % 2 == film.frames[0].shape[1] % 2 == 0
    assert film.table["cost_of_the_true_system_under_the_plan"].tolist() == pytest.approx(
        [*futures[0].costs, *futures[4].costs]
    )
    write_clip(tmp_path / "plan.webm", film.frames, film.rate)
    assert (tmp_path / "plan.webm").stat().st_size > 0
    short = make_film(episode, {7: Future(np.zeros(0), [])}, 0.05)  # an episode that ended at once
    assert short.table["cost_of_the_true_system_under_the_plan"].isna().all()

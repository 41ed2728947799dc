"""The circle that a quadrotor follows: errors by hand, what is seen, commands that only push, and a flight."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.tasks import load_task
from deepkoco.graph.live import WallClockRuntime
from deepkoco.systems import make_system
from deepkoco.systems.bodies.circle_path import outwards
from deepkoco.systems.bodies.quadrotor import attitude_for
from deepkoco.systems.bodies.quadrotor_height import FULL_THRUST

HOVER = 0.033 * 9.81
CLIP = np.array([[0.0, -0.5, -0.5], [FULL_THRUST, 0.5, 0.5]], np.float32)
CIRCLE = {"system": "quadrotor", "task": "quadrotor_circle", "executor": "eager"}


def task_and_scene():
    task = load_task("quadrotor_circle")
    scene = task.scene(make_system("quadrotor"))
    return task.on(scene), scene


def state(place, velocity, radius=0.5, speed=1.0):
    return torch.tensor([[*place, *velocity, radius, speed]], dtype=torch.float64)


def test_the_cost_is_the_way_from_the_circle_and_the_difference_from_its_velocity():
    """At (0, 0.8, 0.4) the next point of a circle of 0.5 m is (0, 0.5, 0), its velocity (-1, 0, 0) m/s."""
    task, scene = task_and_scene()
    at = state((0.0, 0.8, 0.4), (-1.0, 0.0, 0.0))
    assert float(task.cost(scene, at, torch.zeros(1, 3))) == pytest.approx(0.5)
    moving = state((0.0, 0.8, 0.4), (-0.8, 0.1, 0.2))
    extra = task.velocity_weight * (0.2**2 + 0.1**2 + 0.2**2)
    assert float(task.cost(scene, moving, torch.zeros(1, 3))) == pytest.approx(0.5 + extra)
    told = task.readings(scene, moving)
    assert (float(told["path_error"]), float(told["speed_along"])) == pytest.approx((0.5, 0.8))


def test_what_is_seen_has_the_acceleration_of_the_path_and_its_rate():
    """At (0.5, 0, 0): 1 m/s on 0.5 m is 2 m/s2 towards -x, which turns at 2 rad/s towards -y."""
    task, scene = task_and_scene()
    seen = task.observation(scene, state((0.5, 0.0, 0.1), (0.0, 1.5, 0.0)))[0]
    assert seen.numpy() == pytest.approx([0.0, 0.0, 0.1, 0.0, 0.5, 0.0, -2.0, 0.0, 0.0, -4.0])


def test_an_observation_tells_the_measurement_back():
    task, scene = task_and_scene()
    start = task.start(scene, 20, torch.Generator().manual_seed(0))
    for one, seen in zip(start, task.observation(scene, start), strict=True):
        assert task.measurement(scene, seen.numpy()) == pytest.approx(one.numpy(), abs=1e-9)


def test_every_start_asks_for_a_circle_that_can_be_flown():
    task, scene = task_and_scene()
    radius, speed = task.start(scene, 500, torch.Generator().manual_seed(1))[:, 6:].unbind(-1)
    assert ((radius >= 0.25) & (radius <= 1.0)).all()
    assert (speed**2 / radius <= task.steepest + 1e-9).all()
    assert (speed >= 0.6).all()


def test_an_action_of_zero_is_the_middle_of_a_command_that_only_pushes():
    normalized, physical = DelayGraphEnv(**CIRCLE), DelayGraphEnv(action_units="physical", **CIRCLE)
    assert physical.action_space.low.tolist() == pytest.approx([0.0, -0.5, -0.5])
    assert physical.action_space.high.tolist() == pytest.approx([FULL_THRUST, 0.5, 0.5])
    for action, thrust in ((-1.0, 0.0), (0.0, 0.5 * FULL_THRUST), (1.0, FULL_THRUST)):
        normalized.reset(seed=0)
        normalized.step(np.array([action, 0.0, 0.0], np.float32))
        assert normalized.batch.state.nodes["agent"]["command"][0, 0] == pytest.approx(thrust, abs=1e-6)


def test_past_actions_are_shown_in_units_of_the_action():
    env = DelayGraphEnv(action_history=2, **CIRCLE)
    env.reset(seed=0)
    action = np.array([0.3, -0.2, 0.1], np.float32)
    seen = env.step(action)[0]
    assert seen[10:13] == pytest.approx(action, abs=1e-6)


def test_a_quadrotor_hovers_until_its_first_command_acts():
    env = DelayGraphEnv(action_units="physical", **CIRCLE)
    env.reset(seed=0, options={"initial_state": np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.0])})
    for _ in range(10):
        env.step(np.array([HOVER, 0.0, 0.0], np.float32))
    assert np.abs(env.batch.state.nodes["agent"]["truth"][0, :6].numpy() - [0.5, 0, 0, 0, 0, 0]).max() < 1e-6


def feedback(seen):
    """A position controller with the acceleration of the path as feedforward, 0.18 s ahead."""
    commands = []
    for e in seen:
        path = np.array([*(e[6:8] + 0.18 * e[8:10]), 0.0])
        wanted = -6.0 * e[:3] * [1.0, 1.0, 2.0] - 4.0 * e[3:6] + path
        commands.append(attitude_for(tuple(wanted), 0.033))
    return np.array(commands, np.float32)


def test_a_feedback_on_what_is_seen_follows_the_circle():
    envs = DelayGraphVectorEnv(4, 250, action_units="physical", noise=True, **CIRCLE)
    start = np.array(
        [[r, 0.0, 0.0, 0.0, 0.0, 0.0, r, v] for r, v in ((0.3, 0.6), (0.5, 0.8), (0.5, 1.0), (1.0, 1.0))]
    )
    seen, _ = envs.reset(seed=0, options={"initial_state": start})
    errors = []
    for _ in range(200):
        seen, _, ended, _, info = envs.step(np.clip(feedback(seen), *CLIP))
        assert not ended.any()
        errors.append(info["path_error"])
    assert np.array(errors)[100:].mean(0).max() < 0.15


def test_a_flight_that_leaves_the_box_ends_and_pays():
    env = DelayGraphEnv(**CIRCLE)
    env.reset(seed=0, options={"initial_state": np.array([0.5, 0.0, -0.95, 0.0, 0.0, -3.0, 0.5, 1.0])})
    for _ in range(3):
        _, reward, ended, _, _ = env.step(np.array([-1.0, 0.0, 0.0], np.float32))
        if ended:
            break
    assert ended
    assert reward < -100.0


def test_the_compiled_environment_flies_as_the_eager_one():
    seen = {}
    for executor in ("eager", "fused"):
        envs = DelayGraphVectorEnv(
            3,
            60,
            **{**CIRCLE, "executor": executor},
            noise=True,
            action_history=2,
            randomize={"roll_lag": (0.1, 0.2)},
        )
        rng, rows = np.random.default_rng(0), [envs.reset(seed=1)[0]]
        rows += [envs.step(rng.uniform(-0.4, 0.4, (3, 3)).astype(np.float32))[0] for _ in range(40)]
        assert envs.executor == executor
        seen[executor] = np.array(rows)
    np.testing.assert_allclose(seen["fused"], seen["eager"], atol=1e-5)


def test_the_nodes_fly_in_wall_clock_time_too():
    envs = DelayGraphVectorEnv(1, 60, **CIRCLE)
    start = torch.tensor([[0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.0]], dtype=torch.float64)
    parameters = {**envs.system.default_parameters(), "start": start}
    with WallClockRuntime(envs.graph, time_limit=20.0, beat_limit=20.0) as runtime:
        runtime.reset(dict.fromkeys(("world", "sensor"), parameters), torch.Generator().manual_seed(0))
        runtime.run(lambda seen: torch.tensor([[HOVER, 0.0, 0.1]], dtype=torch.float64), 25)
        episode = runtime.finish()
    places = episode.outputs["world"][:, :3]
    assert places[-1, 0] > places[0, 0]  # a pitch of 0.1 rad pushes along x
    assert np.isfinite(places).all()


def test_the_environment_keeps_the_contract_and_draws_itself():
    env = gymnasium.make("deepkoco/QuadrotorCircle-v0", render_mode="rgb_array", executor="eager")
    check_env(env.unwrapped)
    env.reset(seed=0, options={"initial_state": np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.5, 1.0])})
    picture = env.render()
    assert picture.shape == (256, 256, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3


def test_the_centre_is_a_radius_away_from_the_circle():
    place = torch.tensor([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]], dtype=torch.float64)
    cosine, sine = outwards(place)
    assert (cosine.tolist(), sine.tolist()) == ([1.0, 0.0], [0.0, 1.0])

"""The landing as an environment: the checker, what ends an episode and how, what is seen and paid, seeds."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import deepkoco.envs
from deepkoco.engines.landing.deck import deck_pose
from deepkoco.envs.landing import landing_start
from deepkoco.envs.landing.landing_env import LandingEnv, LandingVectorEnv
from deepkoco.envs.settings import SettingsError

HOVER = np.array([0.324 / 0.31 - 1.0, 0.0, 0.0], np.float32)


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def start_on(
    incline: float,
    speed: float,
    above: float = 0.0,
    sink: float = 0.0,
    aside: float = 0.0,
    aligned: bool = True,
):
    """Start states of a body that goes with the deck: above it, towards it, aside of its centre along the deck."""
    start = landing_start(tensor(incline), tensor(speed), torch.Generator().manual_seed(4))
    start["deck"]["swing"] = tensor(0.0)
    pose = deck_pose(start["deck"])
    n = pose.normal
    across = torch.stack([-n[:, 1], n[:, 0], 0.0 * n[:, 0]], -1)
    across = across / across.norm() if incline else tensor(1.0, 0.0, 0.0)[None]
    place, velocity = pose.place + above * n + aside * across, pose.velocity - sink * n
    start["world"]["state"] = torch.cat([place, velocity], -1)
    if aligned:
        nx, ny, nz = n.unbind(-1)
        start["world"]["effort"][:, 1:] = torch.stack([-torch.asin(ny), torch.atan2(nx, nz)], -1)
    return start


def begin(**how):
    env = LandingEnv(executor="eager", noise=False, randomize={"deck.turn_spread": (0.0, 0.0)})
    start = start_on(**how)
    return env, env.reset(
        seed=0, options={"initial": {node: {k: v[0] for k, v in own.items()} for node, own in start.items()}}
    )


@pytest.mark.parametrize(("incline", "speed"), [(0.0, 0.0), (0.3, 0.0), (0.0, 1.0), (np.radians(25.0), 1.0)])
def test_rest_on_an_aligned_deck_is_a_landing(incline: float, speed: float):
    env, (_, info) = begin(incline=incline, speed=speed)
    assert info["touched"]
    assert info["success"]
    _, reward, terminated, *_, info = env.step(HOVER)
    assert terminated
    assert info["success"]
    assert [info[n] for n in ("offset", "sink", "slip", "tilt")] == pytest.approx([0.0] * 4, abs=1e-6)
    # Nothing but the time that it took.
    assert reward == pytest.approx(-env.batch.graph.node("agent").hurry, abs=0.02)


def test_a_level_body_on_a_steep_deck_is_no_landing():
    _, (_, info) = begin(incline=0.3, speed=0.5, aligned=False)
    assert info["touched"]
    assert not info["success"]
    assert info["tilt"] == pytest.approx(0.3)


@pytest.mark.parametrize(("sink", "success"), [(0.5, True), (1.0, False)])
def test_a_touch_down_is_measured_where_the_plane_is_crossed(sink: float, success: bool):
    """8 mm above a level deck it takes less than two ticks; the thrust of the hover keeps the speed."""
    env, (_, info) = begin(incline=0.0, speed=0.7, above=0.008, sink=sink, aside=0.1)
    assert not info["touched"]
    _, _, terminated, _, info = env.step(HOVER)
    assert terminated
    assert info["success"] is success
    assert (info["offset"], info["sink"]) == pytest.approx((0.1, sink), abs=2e-3)


def test_from_below_it_is_a_collision():
    env, _ = begin(incline=0.0, speed=0.0, above=-0.005, sink=-0.6)
    *_, info = env.step(HOVER)
    assert info["touched"]
    assert not info["success"]


def test_beside_the_deck_there_is_nothing_until_the_ground():
    """0.4 m aside it falls from 1 cm above the plane to the ground 40 cm below: 0.29 s."""
    env, _ = begin(incline=0.0, speed=0.0, above=0.01, aside=0.4)
    rewards = []
    for _ in range(60):
        _, reward, terminated, _, info = env.step(np.array([-1.0, 0.0, 0.0], np.float32))
        rewards.append(reward)
        if terminated:
            break
    assert not info["touched"]
    # The thrust falls off with the lag of the motors, 65 ms, after 15 ms.
    assert 0.28 < 0.02 * len(rewards) < 0.45
    assert rewards[-1] < -60.0
    assert max(rewards[:-1]) < 0.0
    assert min(rewards[:-1]) > -1.0


def test_after_a_touch_down_the_motors_stop():
    env, _ = begin(incline=0.0, speed=0.0)
    for _ in range(20):
        env.step(np.ones(3, np.float32))
    assert float(env.batch.state.nodes["world"]["effort"][0, 0]) < 0.02
    assert bool(env.batch.state.nodes["motor_stop"]["stopped"])


def test_the_environment_checker_finds_nothing():
    env = gymnasium.make("deepkoco/InclinedLanding-v0", render_mode="rgb_array", executor="eager").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


def test_many_at_once_are_registered_too():
    envs = gymnasium.make_vec(
        "deepkoco/InclinedLanding-v0", num_envs=3, vectorization_mode="vector_entry_point", executor="eager"
    )
    assert envs.reset(seed=0)[0].shape == (3, 43)
    observation, reward, *_ = envs.step(envs.action_space.sample())
    assert envs.observation_space.contains(observation)
    assert (reward < 0.0).all()
    deepkoco.envs.register_envs()  # a second time does nothing


def flown(seed: int, **settings):
    envs = LandingVectorEnv(
        3, executor="eager", deck_delay={"law": "uniform", "low": 0.02, "high": 0.08}, **settings
    )
    seen, rng = [envs.reset(seed=seed)[0]], np.random.default_rng(1)
    for _ in range(15):
        seen.append(envs.step(rng.normal(0.0, 0.2, (3, 3)).astype(np.float32))[0])
    return np.array(seen)


def test_an_episode_follows_from_its_seed():
    np.testing.assert_array_equal(flown(5), flown(5))
    assert np.abs(flown(5) - flown(6)).max() > 0.1


def test_the_compiled_executor_agrees_with_torch():
    ends = []
    for executor in ("eager", "fused"):
        ranges = {
            "world.mass": (0.03, 0.036),
            "world.roll_delay": (0.02, 0.1),
            "deck_sensor->agent": (0.03, 0.07),
        }
        envs = LandingVectorEnv(3, executor=executor, randomize=ranges)
        envs.reset(seed=2)
        rng = np.random.default_rng(1)
        rows = [envs.step(rng.normal(0.0, 0.2, (3, 3)).astype(np.float32)) for _ in range(12)]
        assert envs.executor == executor
        ends.append(rows)
    for eager, fused in zip(*ends, strict=True):
        np.testing.assert_allclose(eager[0], fused[0], atol=1e-5)
        np.testing.assert_allclose(eager[1], fused[1], atol=1e-9)


def test_the_deck_is_seen_where_it_was_a_delay_ago():
    """1 m/s and 0.1 s: the deck is seen 0.1 m behind, the body as it is."""
    env = LandingEnv(
        executor="eager", noise=False, deck_delay=0.1, randomize={"deck.turn_spread": (0.0, 0.0)}
    )
    env.reset(seed=0, options={"incline": 0.2, "speed": 1.0})
    for _ in range(20):
        observation, *_ = env.step(HOVER)
    truth = env.batch.state.nodes["touchdown"]["way"][0].numpy()
    heading = float(env.batch.state.nodes["deck"]["heading"][0])
    np.testing.assert_allclose(
        observation[:2] - truth[:2], 0.1 * np.array([np.cos(heading), np.sin(heading)]), atol=1e-5
    )
    assert observation[10] == pytest.approx(
        float(observation[:3] @ [*observation[6:8], np.cos(0.2)]), abs=1e-5
    )


def test_each_command_of_the_body_has_its_own_delay():
    """A step of all commands: thrust acts after 20 ms, pitch after 100 ms."""
    env = LandingEnv(
        executor="eager", noise=False, action_history=0, parameters={"thrust_delay": 0.02, "pitch_delay": 0.1}
    )
    env.reset(seed=0)
    efforts = []
    for _ in range(8):
        env.step(np.array([1.0, 0.0, 1.0], np.float32))
        efforts.append(env.batch.state.nodes["world"]["effort"][0].numpy().copy())
    pitch = np.array(efforts)[:, 2]
    # The command is sent at 0; after the k-th step it is 20 k ms.
    assert (pitch[:5] < 1e-12).all()
    assert pitch[5] == pytest.approx(0.5 * (1.0 - np.exp(-0.02 / 0.15)), rel=1e-6)


def test_inclines_and_speeds_lie_in_their_ranges():
    envs = LandingVectorEnv(64, executor="eager", incline=(0.1, 0.2), speed=(0.5, 0.6))
    envs.reset(seed=0)
    deck = envs.state.nodes["deck"]
    for name, low, high in (("incline", 0.1, 0.2), ("speed", 0.5, 0.6)):
        assert low <= float(deck[name].min()) < float(deck[name].max()) <= high


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"incline": (0.0, 1.0)}, r"incline = \(0.0, 1.0\) rad; give \(low, high\) inside"),
        ({"speed": (1.0, 0.5)}, "speed = .* give"),
        ({"randomize": {"world.mass": (0.0, 0.1)}}, "world.mass = .* give"),
        ({"action_history": 1.5}, "action_history = 1.5; give a whole number"),
        ({"noise": "yes"}, "noise = 'yes'; give True or False"),
        ({"deck_delay": -1.0}, "-1"),
    ],
)
def test_wrong_settings_are_refused(given, message):
    with pytest.raises(SettingsError, match=message):
        LandingVectorEnv(2, executor="eager", **given)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"incline": 0.1}, "needs both"),
        ({"incline": 0.1, "speed": 9.0}, "speed = 9.0; give"),
        ({"sped": 1.0}, "sped"),
    ],
)
def test_a_start_that_is_none_is_refused(options, message):
    env = LandingVectorEnv(2, executor="eager")
    with pytest.raises(SettingsError, match=message):
        env.reset(seed=0, options=options)


def test_it_is_drawn():
    env = LandingEnv(render_mode="rgb_array", render_size=128, executor="eager")
    env.reset(seed=0)
    env.step(HOVER)
    before = env.render()
    for _ in range(10):
        env.step(HOVER)
    after = env.render()
    assert before.shape == after.shape == (128, 128, 3)
    assert (before != after).any()

"""The environments: Gymnasium's own pendulum without delays, the graph's delays with them."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import deepkoco.envs
from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.graph import HorizonError
from deepkoco.systems import ExtendedSystem, make_system, rk4_step

FLAT = {"system": "rod_pendulum", "action_units": "physical"}


def roll(env, actions, seed: int = 0, **options):
    observations = [env.reset(seed=seed, options=options or None)[0]]
    rewards = []
    for action in actions:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations), np.array(rewards)


def test_without_delays_it_is_gymnasiums_pendulum_step_by_step():
    reference = gymnasium.make("Pendulum-v1")
    ours = gymnasium.make("deepkoco/RodPendulum-v0")
    generator = np.random.default_rng(0)
    for seed in range(3):
        reference.reset(seed=seed)
        state = reference.unwrapped.state.copy()
        ours.reset(seed=seed, options={"initial_state": state})
        for _ in range(200):
            action = generator.uniform(-1, 1, 1).astype(np.float32)
            expected, expected_reward, _, end, _ = reference.step(2 * action)
            observation, reward, _, truncated, _ = ours.step(action)
            np.testing.assert_allclose(observation, expected, atol=2e-4)
            assert reward == pytest.approx(expected_reward, abs=1e-3)
            assert truncated == end
        assert truncated


@pytest.mark.parametrize("name", sorted(deepkoco.envs.ENVIRONMENTS))
def test_the_environment_checker_finds_nothing(name: str):
    robot = {"system": "two_link_arm"} if name == "deepkoco/Robot-v0" else {}
    env = gymnasium.make(name, render_mode="rgb_array", **robot).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


def test_an_actuation_delay_of_whole_ticks_shifts_the_commands():
    """20 ms at 100 Hz: each command acts two world ticks after the agent's tick."""
    commands = np.array([[1.5], [-2.0], [0.7], [2.0]])
    env = DelayGraphVectorEnv(1, actuation_delay=0.02, **FLAT)
    start = np.array([[2.0, 0.3]])
    observations, _ = roll(env, commands[:, None], initial_state=start)
    system = make_system("rod_pendulum")
    state, ticks = torch.tensor(start[0]), [system_observation(env, start[0])]
    for tick in range(1, 21):
        sent = int((tick - 1 - 2) // 5)  # the world tick at 10 ms * tick covers the 10 ms before it
        effort = torch.tensor(commands[sent, 0] if tick > 2 else 0.0)
        state = rk4_step(system, state, effort, 0.01, system.default_parameters())
        if tick % 5 == 0:
            ticks.append(system_observation(env, state.numpy()))
    np.testing.assert_allclose(observations[:, 0], ticks, atol=1e-6)


def system_observation(env: DelayGraphVectorEnv, state: np.ndarray) -> np.ndarray:
    return env.task.observation(env.system, torch.as_tensor(state)).numpy().astype(np.float32)


def test_a_delay_finer_than_a_tick_matters():
    """A constant command that arrives 4 ms later gains 4 ms * acceleration less speed."""
    start = {"initial_state": np.array([[np.pi, 0.0]])}
    full = np.full((1, 1, 1), 2.0)
    speeds = []
    for delay in (0.020, 0.024):
        observations, _ = roll(DelayGraphVectorEnv(1, actuation_delay=delay, **FLAT), full, **start)
        speeds.append(observations[1, 0, 2])
    assert speeds[0] - speeds[1] == pytest.approx(0.004 * 6.0, rel=0.05)  # 3 u/(m l^2) = 6 rad/s2


def test_a_sensing_delay_shows_the_past():
    """With 50 ms, one control period, every observation is that of the step before."""
    actions = np.random.default_rng(1).uniform(-2, 2, (30, 1, 1))
    start = {"initial_state": np.array([[1.0, 0.0]])}
    prompt, _ = roll(DelayGraphVectorEnv(1, actuation_delay=0.05, **FLAT), actions, **start)
    late, _ = roll(DelayGraphVectorEnv(1, sensing_delay=0.05, **FLAT), actions, **start)
    # The agent's first tick is 50 ms later, so the same command acts at the same state in both.
    np.testing.assert_allclose(late[1:], prompt[1:], atol=1e-6)


def test_random_delays_differ_between_environments_and_repeat_with_the_seed():
    delay = {"law": "gaussian", "loc": 0.03, "scale": 0.01}
    env = DelayGraphVectorEnv(8, sensing_delay=delay, actuation_delay=delay, **FLAT)
    actions = np.full((20, 8, 1), 1.0)
    start = {"initial_state": np.tile([[1.0, 0.0]], (8, 1))}
    first, _ = roll(env, actions, seed=4, **start)
    again, _ = roll(env, actions, seed=4, **start)
    assert first.tobytes() == again.tobytes()
    assert np.ptp(first[-1, :, 2]) > 1e-3


LAWS = {
    "range": {"randomize": {"DELAY": (0.003, 0.047)}},
    "gaussian": {"DELAY": {"law": "gaussian", "loc": 0.02, "scale": 0.005}},
    # A stall of four control periods, after which five commands come within two ticks of the world.
    "stalls": {
        "DELAY": {"law": "mixture", "components": [{"law": "empirical", "samples": [0.012, 0.017]},
                  {"law": "empirical", "samples": [0.2, 0.156, 0.11]}], "weights": [4, 1]}
    },
}  # fmt: skip


def with_delay(name: str, law: str, **more) -> DelayGraphVectorEnv:
    settings = {key.replace("DELAY", name): value for key, value in LAWS[law].items()}
    if "randomize" in settings:
        settings["randomize"] = {name: LAWS[law]["randomize"]["DELAY"]}
    return DelayGraphVectorEnv(4, max_episode_steps=25, **settings, **FLAT, **more)


def messages(env: DelayGraphVectorEnv, key: str, environment: int) -> tuple[np.ndarray, np.ndarray]:
    timing = env.state.schedule.timing
    edge = timing.layout.connections.index(key)
    sent, received = timing.messages_of(edge, int(env.state.row[environment]))
    return sent / timing.resolution, received / timing.resolution


@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_command_acts_when_it_arrives(law: str):
    """Oracle: RK4 under the average of the zero-order hold between the arrivals, tick by tick."""
    env = with_delay("actuation_delay", law)
    commands = np.random.default_rng(5).uniform(-2, 2, (25, 4, 1))
    start = np.random.default_rng(6).normal(size=(4, 2))
    observations, _ = roll(env, commands, seed=3, initial_state=start)
    system = make_system("rod_pendulum")
    for b in range(4):
        sent, arrival = messages(env, "agent->world", b)
        np.testing.assert_allclose(sent, 0.05 * np.arange(len(sent)), atol=1e-12)
        if law == "range":
            drawn = env.drawn["actuation_delay"][b]
            np.testing.assert_allclose(arrival - sent, drawn, atol=1e-9)
            assert 0.003 <= drawn <= 0.047
        state = torch.tensor(start[b])
        for tick in range(1, 101):
            end, total = 0.01 * tick, 0.0
            edges = [max(a, end - 0.01) for a in arrival if a < end] + [end]
            for k in range(len(edges) - 1):
                total += commands[k, b, 0] * (edges[k + 1] - edges[k])
            state = rk4_step(system, state, torch.tensor(total / 0.01), 0.01, system.default_parameters())
            if tick % 5 == 0:
                expected = system_observation(env, state.numpy())
                np.testing.assert_allclose(observations[tick // 5, b], expected, atol=2e-6)
    assert len({messages(env, "agent->world", b)[1].tobytes() for b in range(4)}) == 4


@pytest.mark.parametrize("law", sorted(LAWS))
def test_the_agent_sees_the_newest_sample_that_has_arrived(law: str):
    env = with_delay("sensing_delay", law)
    start = np.random.default_rng(6).normal(size=(4, 2)) + np.array([2.0, 0.0])
    observations, _ = roll(env, np.zeros((25, 4, 1)), seed=2, initial_state=start)
    system = make_system("rod_pendulum")
    free = [torch.tensor(start)]  # without commands the motion does not depend on any delay
    for _ in range(140):
        free.append(rk4_step(system, free[-1], torch.zeros(4), 0.01, system.default_parameters()))
    agent = np.array([0.05 * k for k in range(26)]) + float(env.graph.phases[env.graph.index["agent"]])
    for b in range(4):
        _, arrival = messages(env, "sensor->agent", b)
        newest = np.searchsorted(arrival, agent + 1e-9, side="right") - 1
        for k, tick in enumerate(newest):
            expected = system_observation(env, free[max(tick, 0)][b].numpy())
            np.testing.assert_allclose(observations[k, b], expected, atol=2e-6)
        if law == "range":
            age = agent - 0.01 * newest
            assert (age >= env.drawn["sensing_delay"][b] - 1e-9).all()
            assert (age < env.drawn["sensing_delay"][b] + 0.01 + 1e-9).all()


def test_before_the_first_message_the_agent_sees_the_start():
    """Half of the messages take 0.2 s; the agent's first tick is at their mean."""
    law = {"law": "empirical", "samples": [0.0, 0.2]}
    env = DelayGraphVectorEnv(
        16, sensing_delay={"law": "mixture", "components": [law], "weights": [1]}, **FLAT
    )
    start = np.tile([[2.0, -0.5]], (16, 1))
    first, _ = env.reset(seed=0, options={"initial_state": start})
    initial = np.array([messages(env, "sensor->agent", b)[1][0] > 0.1 for b in range(16)])
    assert initial.any()
    seen = np.tile(system_observation(env, start[0]), (int(initial.sum()), 1))
    np.testing.assert_allclose(first[initial], seen, atol=1e-6)


def test_a_random_delay_on_top_of_the_models_own_is_refused():
    late = ExtendedSystem(make_system("rod_pendulum"), ("sensing_delay",), {"sensing_delay.delay": 0.03})
    with pytest.raises(ValueError, match=r"sensing_delay: the model has one of 0\.03 s"):
        DelayGraphVectorEnv(
            1, model=late, sensing_delay={"law": "gaussian", "loc": 0.03, "scale": 0.01}, **FLAT
        )


def test_randomized_parameters_differ_between_environments_and_stay_in_their_range():
    env = DelayGraphVectorEnv(16, randomize={"mass": (0.8, 1.2), "actuation_delay": (0.0, 0.05)}, **FLAT)
    env.reset(seed=0)
    masses = env.drawn["mass"]
    assert np.ptp(masses) > 0.1
    assert masses.min() >= 0.8
    assert masses.max() <= 1.2
    before = masses.copy()
    env.reset()
    assert not np.array_equal(before, env.drawn["mass"])


def test_a_model_with_effects_is_simulated():
    """Half the torque gain, hanging at rest: half the acceleration."""
    weak = ExtendedSystem(make_system("rod_pendulum"), ("gain",), {"gain.factor": 0.5})
    start = {"initial_state": np.array([[np.pi, 0.0]])}
    speed = {}
    for name, model in (("nominal", None), ("weak", weak)):
        env = DelayGraphVectorEnv(1, model=model, **FLAT)
        speed[name] = roll(env, np.full((1, 1, 1), 1.0), **start)[0][1, 0, 2]
    assert speed["weak"] == pytest.approx(0.5 * speed["nominal"], rel=1e-3)


def test_a_models_own_delay_equals_the_environments():
    late = ExtendedSystem(make_system("rod_pendulum"), ("actuation_delay",), {"actuation_delay.delay": 0.033})
    actions = np.random.default_rng(2).uniform(-2, 2, (20, 2, 1))
    of_model, _ = roll(DelayGraphVectorEnv(2, model=late, **FLAT), actions)
    of_env, _ = roll(DelayGraphVectorEnv(2, actuation_delay=0.033, **FLAT), actions)
    assert of_model.tobytes() == of_env.tobytes()


def test_past_actions_are_appended_newest_first():
    env = DelayGraphVectorEnv(1, action_history=3, **FLAT)
    observations, _ = roll(env, np.array([0.5, -1.0, 1.5, 2.0])[:, None, None])
    np.testing.assert_allclose(observations[4, 0, 3:], [2.0, 1.5, -1.0])
    assert env.single_observation_space.contains(observations[4, 0])


def test_batch_equals_one_by_one():
    batch = DelayGraphVectorEnv(3, actuation_delay=0.02, **FLAT)
    actions = np.random.default_rng(3).uniform(-2, 2, (25, 3, 1))
    start = np.array([[3.0, 0.1], [1.0, -0.5], [-2.0, 0.9]])
    together, rewards = roll(batch, actions, initial_state=start)
    for i in range(3):
        alone = DelayGraphEnv(actuation_delay=0.02, **FLAT)
        single, reward = roll(alone, actions[:, i], initial_state=start[i])
        np.testing.assert_allclose(single, together[:, i], atol=1e-6)
        np.testing.assert_allclose(reward, rewards[:, i], atol=1e-9)


def test_the_vector_form_starts_anew_after_the_last_step():
    env = gymnasium.make_vec(
        "deepkoco/RodPendulum-v0", num_envs=2, vectorization_mode="vector_entry_point", max_episode_steps=3
    )
    env.reset(seed=0)
    ends = [env.step(np.zeros((2, 1)))[3].all() for _ in range(3)]
    assert ends == [False, False, True]
    _, reward, _, truncated, _ = env.step(np.zeros((2, 1)))
    assert not truncated.any()
    assert (reward == 0).all()
    assert [env.step(np.zeros((2, 1)))[3].all() for _ in range(3)] == [False, False, True]


def test_the_vector_form_starts_anew_at_once_if_asked_to():
    env = gymnasium.make_vec(
        "deepkoco/RodPendulum-v0", num_envs=2, vectorization_mode="vector_entry_point", max_episode_steps=3,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )  # fmt: skip
    env.reset(seed=0)
    for _ in range(2):
        results = [env.step(np.ones((2, 1))) for _ in range(3)]
        assert [result[3].all() for result in results] == [False, False, True]
        assert (results[2][1] != 0).all()
        last = np.stack(results[2][4]["final_obs"])
        assert last.shape == (2, 3)
        assert (last != results[2][0]).any()


def test_gymnasiums_time_limit_is_kept():
    env = gymnasium.make("deepkoco/RodPendulum-v0", max_episode_steps=230)
    env.reset(seed=0)
    ends = [env.step(np.zeros(1, np.float32))[3] for _ in range(230)]
    assert ends == [False] * 229 + [True]


def test_an_episode_longer_than_its_timing_is_told():
    env = DelayGraphEnv(longest_episode=2, **FLAT)
    env.reset(seed=0)
    env.step(np.zeros(1))
    env.step(np.zeros(1))
    with pytest.raises(HorizonError, match="longest_episode"):
        env.step(np.zeros(1))


def test_measurement_noise_has_the_declared_spread():
    env = DelayGraphVectorEnv(64, noise=True, **FLAT)
    observation, _ = env.reset(seed=0, options={"initial_state": np.zeros((64, 2))})
    spread = observation[:, 1:].std(0)  # upright the sine is the angle
    np.testing.assert_allclose(spread, [c.noise_sd for c in env.system.measurements], rtol=0.4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"integrator": "euler"}, "rk4"),
        ({"randomize": {"mas": (1, 2)}}, "mass"),
        ({"randomize": {"mass": (2, 1)}}, "low, high"),
        ({"randomize": {"mass": 1.0}}, "mass = 1.0 kg; give"),
        ({"randomize": {"mass": ("light", 1.0)}}, "low, high"),
        ({"actuation_delay": -0.1}, "-0.1"),
        ({"action_history": -1}, "0 or more"),
        ({"world_rate": 0}, "positive"),
        ({"world_rate": 19.0}, "19 Hz is below the control rate .* 20 Hz"),
        ({"model": "no_such.yaml"}, "no_such.yaml"),
    ],
)
def test_wrong_settings_are_told(settings, message):
    with pytest.raises(ValueError, match=message):
        DelayGraphVectorEnv(1, system="rod_pendulum", **settings)


def test_rendering_shows_the_state():
    env = gymnasium.make("deepkoco/RodPendulum-v0", render_mode="rgb_array")
    env.reset(seed=0, options={"initial_state": np.array([0.0, 0.0])})
    up = env.render()
    env.reset(seed=0, options={"initial_state": np.array([np.pi, 0.0])})
    assert up.shape == (256, 256, 3)
    hanging = env.render()
    # Half a turn of the picture; the edges of shapes differ by their anti-aliasing.
    assert np.mean(np.abs(up[::-1, ::-1].astype(int) - hanging) > 30) < 0.01
    assert np.mean(np.abs(up.astype(int) - hanging) > 30) > 0.02


EXACT = {"world_rate": 20.0, "integrator": "semi_implicit_euler"}
CASES = {
    "bare": EXACT,
    "delays": {"actuation_delay": 0.023, "sensing_delay": 0.041, "action_history": 2},
    "random delays": {"sensing_delay": {"law": "gaussian", "loc": 0.03, "scale": 0.01}, "noise": True},
    "ranges": {"randomize": {"mass": (0.8, 1.2), "actuation_delay": (0.0, 0.05)}},
}


@pytest.mark.parametrize("case", sorted(CASES))
def test_the_compiled_executor_gives_what_the_eager_one_gives(case: str):
    """Beyond the limit of the episode, so that a reset is among the steps; angles of a free swing stay near."""
    actions = np.random.default_rng(0).uniform(-1, 1, (25, 6, 1))
    both = []
    for executor in ("eager", "auto"):
        env = DelayGraphVectorEnv(6, max_episode_steps=20, executor=executor, **CASES[case], **FLAT)
        both.append((*roll(env, actions, seed=3), env.executor))
    (expected, rewards, eager), (observations, others, _) = both
    assert eager == "eager"
    np.testing.assert_allclose(observations, expected, atol=1e-5)
    np.testing.assert_allclose(others, rewards, atol=1e-4)


def test_one_environment_reads_what_a_batch_reads():
    settings = {"actuation_delay": 0.023, "action_history": 2, "max_episode_steps": 50}
    actions = np.random.default_rng(0).uniform(-2, 2, (30, 1)).astype(np.float32)
    start = {"initial_state": np.array([1.0, 0.5])}
    batch = DelayGraphVectorEnv(1, **settings, **FLAT)
    together, rewards = roll(batch, actions[:, None], initial_state=start["initial_state"][None])
    for executor in ("eager", "auto"):
        alone = DelayGraphEnv(executor=executor, actuation_delay=0.023, action_history=2, **FLAT)
        observations, own = roll(alone, actions, **start)
        assert observations.dtype == np.float32
        np.testing.assert_allclose(observations, together[:, 0], atol=1e-5)
        np.testing.assert_allclose(own, rewards[:, 0], atol=1e-5)


def test_observations_of_the_steps_before_are_appended_newest_first():
    envs = DelayGraphVectorEnv(
        2, 10, system="rod_pendulum", observation_history=2, action_history=1, executor="eager"
    )
    rows = [envs.reset(seed=3)[0]]
    assert rows[0].shape == (2, 10) == envs.observation_space.shape
    np.testing.assert_array_equal(rows[0][:, 3:], 0.0)
    for action in (0.5, -0.25):
        rows.append(envs.step(np.full((2, 1), action, np.float32))[0])
    np.testing.assert_array_equal(rows[2][:, 3:6], rows[1][:, :3])
    np.testing.assert_array_equal(rows[2][:, 6:9], rows[0][:, :3])
    np.testing.assert_allclose(rows[2][:, 9], -0.25)

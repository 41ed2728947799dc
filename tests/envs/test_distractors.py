"""Distractors leave the task alone, have their own draws and keep their order."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.distractors import DistractorOptions, StateDistractors, VectorStateDistractors

SMOOTH_SPEED = 2 * 15.0 + 15.0  # largest acceleration the physics allows [rad/s2]: 3 g/2l + 3 u/ml^2


def wrapped(shuffle_seed: int = 0, copies: int = 4) -> StateDistractors:
    options = DistractorOptions(copies=copies)
    return StateDistractors(gymnasium.make("Pendulum-v1"), options=options, shuffle_seed=shuffle_seed)


def roll(env, seed: int, steps: int = 20) -> np.ndarray:
    observation, _ = env.reset(seed=seed)
    rows = [observation]
    for k in range(steps):
        rows.append(env.step(np.array([np.sin(k)], np.float32))[0])
    return np.array(rows)


def test_the_task_is_untouched():
    env = wrapped()
    plain = roll(gymnasium.make("Pendulum-v1"), seed=3)
    mixed = roll(env, seed=3)
    task_columns = np.argsort(env.mixer.order)[:3]
    np.testing.assert_array_equal(mixed[:, task_columns], plain)
    assert mixed.shape[1] == 15


def test_same_seed_same_bytes_and_other_seed_other_distractors():
    first, again, other = roll(wrapped(), 5), roll(wrapped(), 5), roll(wrapped(), 6)
    assert first.tobytes() == again.tobytes()
    columns = np.argsort(wrapped().mixer.order)[3:]
    assert np.abs(first[:, columns] - other[:, columns]).max() > 0.5


def test_the_order_depends_on_the_shuffle_seed_alone():
    assert np.array_equal(wrapped(1).mixer.order, wrapped(1).mixer.order)
    assert not np.array_equal(wrapped(1).mixer.order, wrapped(2).mixer.order)
    assert sorted(wrapped(1).mixer.order) == list(range(15))


def test_distractors_swing_like_pendulums():
    """Each copy lies on the unit circle and its speed changes no quicker than its torque allows."""
    env = wrapped()
    rows = roll(env, seed=1, steps=100)[:, np.argsort(env.mixer.order)]
    for copy in range(4):
        cosine, sine, speed = rows[:, 3 + 3 * copy : 6 + 3 * copy].T
        np.testing.assert_allclose(cosine**2 + sine**2, 1.0, atol=1e-6)
        assert np.abs(np.diff(speed)).max() <= 0.05 * SMOOTH_SPEED
        assert speed.std() > 0.3


def test_observations_stay_in_their_space():
    env = wrapped()
    for row in roll(env, seed=2, steps=100):
        assert env.observation_space.contains(row)


def test_the_vector_form_restarts_copies_with_their_environment():
    env = VectorStateDistractors(gymnasium.make_vec("Pendulum-v1", num_envs=2, max_episode_steps=5))
    env.reset(seed=0)
    columns = np.argsort(env.mixer.order)[3:]
    jumps = []
    before = env.step(np.zeros((2, 1), np.float32))[0]
    for _ in range(7):
        after = env.step(np.zeros((2, 1), np.float32))[0]
        jumps.append(np.abs(after[:, columns] - before[:, columns]).max())
        before = after
    assert np.argmax(jumps) == 4  # steps 2..5 end the episode, the sixth is the reset
    assert jumps[4] > 2 * max(jumps[:4])


def vector(mode: AutoresetMode) -> VectorStateDistractors:
    def make() -> gymnasium.Env:
        return gymnasium.make("Pendulum-v1", max_episode_steps=4)

    return VectorStateDistractors(SyncVectorEnv([make, make], autoreset_mode=mode))


def test_copies_restart_at_once_with_same_step_autoreset():
    env = vector(AutoresetMode.SAME_STEP)
    columns = np.argsort(env.mixer.order)
    rows, nothing = [env.reset(seed=0)[0]], np.zeros((2, 1), np.float32)
    for _ in range(4):
        row, _, _, truncated, info = env.step(nothing)
        rows.append(row)
    assert truncated.all()
    jumps = np.abs(np.diff(np.array(rows)[..., columns[3:]], axis=0)).max(axis=(1, 2))
    assert jumps[3] > 2 * jumps[:3].max()
    # The last observation is that of the episode that ended, copies included.
    last = np.stack(info["final_obs"])[:, columns]
    assert last.shape == (2, 15)
    assert np.abs(last[:, 3:] - rows[3][:, columns[3:]]).max() < 2 * jumps[:3].max()
    np.testing.assert_allclose(last[:, 0] ** 2 + last[:, 1] ** 2, 1.0, atol=1e-6)


def test_a_masked_reset_restarts_its_copies_alone():
    env = vector(AutoresetMode.DISABLED)
    columns = np.argsort(env.mixer.order)[3:]
    env.reset(seed=0)
    before = [env.step(np.zeros((2, 1), np.float32))[0] for _ in range(4)][-1][:, columns]
    after = env.reset(options={"reset_mask": np.array([False, True])})[0][:, columns]
    assert np.array_equal(after[0], before[0])
    assert np.abs(after[1] - before[1]).max() > 0.1


def test_a_masked_reset_leaves_those_that_wait_to_their_own_restart():
    """Both end at step 4; the second is reset by hand, the first starts anew with the next step."""
    env = vector(AutoresetMode.NEXT_STEP)
    columns = np.argsort(env.mixer.order)[3:]
    env.reset(seed=0)
    last = [env.step(np.zeros((2, 1), np.float32))[0] for _ in range(4)][-1][:, columns]
    env.reset(options={"reset_mask": np.array([False, True])})
    after = env.step(np.zeros((2, 1), np.float32))[0][:, columns]
    assert np.abs(after[0] - last[0]).max() > 1.0


def test_environments_without_a_seed_have_distractors_of_their_own():
    columns = np.argsort(wrapped().mixer.order)[3:]
    first, other = (wrapped().reset()[0][columns] for _ in range(2))
    assert np.abs(first - other).max() > 1e-3


def test_the_picture_shows_the_distractors():
    env = StateDistractors(gymnasium.make("deepkoco/RodPendulum-v0", render_mode="rgb_array"), "copies+noise")
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (256 + 2 * 64, 256, 3)  # one row of four copies and one picture of the noise
    env.step(np.zeros(1, np.float32))
    changed = (env.render() != first).any((1, 2))
    assert changed[256:320].any()
    assert changed[320:].any()


@pytest.mark.parametrize("copies", [1, 2])
def test_any_number_of_copies(copies: int):
    assert wrapped(copies=copies).observation_space.shape == (3 + 3 * copies,)

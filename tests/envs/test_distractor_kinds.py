"""What every distractor keeps to, of states and of frames, in every combination."""

import cv2
import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st

import deepkoco.envs
from deepkoco.envs.distractors import (
    DistractorError,
    DistractorOptions,
    Setup,
    StateDistractors,
    VectorStateDistractors,
)
from deepkoco.envs.distractors.projection import random_rotation
from deepkoco.envs.distractors.registry import PIXEL, STATE, make_distractors, parse_distractors
from deepkoco.envs.distractors.wandering import WanderingSystems
from deepkoco.envs.pixels import Pixels, VectorPixels
from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory

TASK = TaskConfig("pendulum", "deepkoco/RodPendulum-v0", kwargs={"action_units": "physical"})
STEPS = 6
KINDS = [
    *(("states", name) for name in (*STATE, "copies+noise", "copies+noise+projection")),
    *(("images", name) for name in (*PIXEL, "background+copies+colour+camera+sensor_noise")),
]
every_kind = pytest.mark.parametrize(("observation", "name"), KINDS)


@pytest.fixture(scope="session")
def videos(tmp_path_factory) -> str:
    """A folder with a video and two folders of pictures."""
    folder = tmp_path_factory.mktemp("videos")
    generator = np.random.default_rng(0)
    writer = cv2.VideoWriter(str(folder / "b.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (96, 64))
    for _ in range(5):
        writer.write(cv2.resize(generator.integers(0, 256, (4, 6, 3), np.uint8), (96, 64)))
    writer.release()
    for name in ("a", "c"):
        (folder / name).mkdir()
        for k in range(4):
            picture = generator.integers(0, 256, (40, 60, 3), np.uint8)
            cv2.imwrite(str(folder / name / f"{k:03}.png"), picture)
    return str(folder)


def make(observation: str, name: str, videos: str, split: str = "train", count: int = 2, **options):
    chosen = DistractorOptions(videos=videos, **options)
    return make_task_factory(TASK, name, observation, chosen, split)(count, 0)


def roll(envs, seed: int | None, steps: int = STEPS) -> tuple[np.ndarray, np.ndarray]:
    """Observations (steps + 1, B, ...) and rewards (steps, B) under fixed actions."""
    seen, rewards = [envs.reset(seed=seed)[0]], []
    for k in range(steps):
        action = np.full(envs.action_space.shape, 1.5 * np.sin(k), np.float32)
        observation, reward, *_ = envs.step(action)
        seen.append(observation)
        rewards.append(reward)
    return np.array(seen), np.array(rewards)


@every_kind
def test_all_follows_from_the_seed_of_the_reset_so_a_resumed_run_sees_the_same(observation, name, videos):
    """Environments that have seen other episodes before and new ones see the same after reset(seed)."""
    used = make(observation, name, videos)
    first, _ = roll(used, seed=1)
    roll(used, seed=2, steps=3)
    again, _ = roll(used, seed=1)
    fresh, _ = roll(make(observation, name, videos), seed=1)
    assert first.tobytes() == again.tobytes() == fresh.tobytes()
    assert roll(used, seed=3)[0].tobytes() != first.tobytes()


@every_kind
def test_they_change_neither_rewards_nor_each_other_split(observation, name, videos):
    seen, rewards = roll(make(observation, name, videos), seed=4)
    other, same = roll(make(observation, name, videos, "evaluation"), seed=4)
    _, plain = roll(make("states", "none", videos), seed=4)
    assert rewards.tobytes() == same.tobytes() == plain.tobytes()
    assert not np.array_equal(seen, other)


@every_kind
def test_observations_stay_in_their_space(observation, name, videos):
    envs = make(observation, name, videos)
    for row in roll(envs, seed=5)[0]:
        assert envs.observation_space.contains(row)


@pytest.mark.parametrize("name", [n for kind, n in KINDS if kind == "images"])
def test_frames_at_intensity_zero_are_those_without_distractors(name, videos):
    none = roll(make("images", name, videos, intensity=0.0), seed=6)[0]
    assert none.tobytes() == roll(make("images", "none", videos), seed=6)[0].tobytes()
    weak, strong = (roll(make("images", name, videos, intensity=i), seed=6)[0] for i in (0.3, 1.0))
    distances = [np.abs(seen.astype(float) - none).mean() for seen in (weak, strong)]
    assert 0.0 < distances[0] < distances[1]


@pytest.mark.parametrize("name", [n for kind, n in KINDS if kind == "states"])
def test_states_at_intensity_zero_are_those_of_the_task_and_zeros(name, videos):
    envs = make("states", name, videos, intensity=0.0)
    columns = np.argsort(envs.mixer.order)
    seen = roll(envs, seed=6)[0][..., columns]
    assert seen[..., :3].tobytes() == roll(make("states", "none", videos), seed=6)[0].tobytes()
    assert not seen[..., 3:].any()


@every_kind
def test_one_environment_is_a_batch_of_one(observation, name, videos):
    batch = roll(make(observation, name, videos, count=1), seed=7)[0][:, 0]
    single = gymnasium.make(TASK.id, **TASK.kwargs)
    options = DistractorOptions(videos=videos)
    if observation == "images":
        layers = make_distractors(PIXEL, name, 1, options, "rod_pendulum", "train")
        env = Pixels(single, tuple(layers.values()))
    else:
        env = StateDistractors(single, name, options)
    # The environment itself draws its start from other words of the seed, so only the distractors compare:
    # both start in the same state.
    start = {"initial_state": np.array([0.3, 0.0])}
    vector = make(observation, name, videos, count=1)
    one = env.reset(seed=7, options=start)[0]
    row = vector.reset(seed=7, options={"initial_state": np.array([[0.3, 0.0]])})[0][0]
    assert one.tobytes() == row.tobytes()
    for _ in range(3):
        one = env.step(np.ones(1, np.float32))[0]
        row = vector.step(np.ones((1, 1), np.float32))[0][0]
        assert one.tobytes() == row.tobytes()
    assert batch.shape[1:] == one.shape


def short(mode: AutoresetMode, observation: str, name: str, videos: str, length: int = 3):
    envs = SyncVectorEnv(
        [lambda: gymnasium.make(TASK.id, max_episode_steps=length, **TASK.kwargs)] * 2, autoreset_mode=mode
    )
    options = DistractorOptions(videos=videos)
    if observation == "states":
        return VectorStateDistractors(envs, name, options)
    layers = make_distractors(PIXEL, name, 2, options, "rod_pendulum", "train")
    return VectorPixels(envs, tuple(layers.values()))


@every_kind
def test_the_last_observation_of_an_episode_does_not_depend_on_the_autoreset(observation, name, videos):
    nothing = np.zeros((2, 1), np.float32)
    lasts = []
    for mode in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED):
        envs = short(mode, observation, name, videos)
        envs.reset(seed=8)
        for _ in range(3):
            seen, _, _, truncated, info = envs.step(nothing)
        assert truncated.all()
        lasts.append(np.stack(info["final_obs"]) if mode == AutoresetMode.SAME_STEP else seen)
        if mode == AutoresetMode.SAME_STEP:
            assert not np.array_equal(lasts[0], seen)
    assert lasts[0].tobytes() == lasts[1].tobytes() == lasts[2].tobytes()


@every_kind
def test_a_masked_reset_leaves_the_others_as_they_are(observation, name, videos):
    envs = short(AutoresetMode.DISABLED, observation, name, videos)
    envs.reset(seed=9)
    for _ in range(3):
        seen = envs.step(np.zeros((2, 1), np.float32))[0]
    after = envs.reset(options={"reset_mask": np.array([False, True])})[0]
    assert after[0].tobytes() == seen[0].tobytes()
    assert after[1].tobytes() != seen[1].tobytes()


def test_copies_of_the_arm_give_its_ten_entries_each():
    copies = WanderingSystems(Setup("copies", 3, 1.0, "two_link_arm"))
    copies.seed(0)
    copies.restart()
    before = copies.observations()
    for _ in range(20):
        copies.advance()
    after = copies.observations()
    assert before.shape == (3, 4, 10)
    assert np.isfinite(after).all()
    assert (np.abs(after) <= np.array(copies.task.observation_bounds) + 1e-9).all()
    assert np.abs(after - before).max() > 0.5


def test_random_and_wandering_drives_push_with_the_same_limits_but_other_memory():
    memories = {}
    for drive in ("ou", "random"):
        setup = Setup("copies", 50, 1.0, options=DistractorOptions(drive=drive))
        copies = WanderingSystems(setup)
        copies.seed(0)
        copies.restart()
        drives = []
        for _ in range(60):
            copies.advance()
            drives.append(copies._drive.numpy().ravel())
        now, following = np.array(drives[20:-1]).ravel(), np.array(drives[21:]).ravel()
        memories[drive] = float(np.corrcoef(now, following)[0, 1])
    assert memories["ou"] == pytest.approx(0.85, abs=0.03)
    assert memories["random"] == pytest.approx(0.0, abs=0.05)


@given(size=st.integers(2, 24), fraction=st.floats(0.0, 1.0), seed=st.integers(0, 2**20))
@settings(max_examples=30, deadline=None)
def test_a_projection_loses_nothing(size: int, fraction: float, seed: int):
    rotation = random_rotation(size, fraction, seed)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(size), atol=1e-5)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-4)
    half = random_rotation(size, fraction / 2.0, seed)
    np.testing.assert_allclose(half @ half, rotation, atol=2e-5)


def test_the_task_can_be_read_back_from_a_projection(videos):
    envs = make("states", "projection", videos)
    seen = roll(envs, seed=1)[0][..., np.argsort(envs.mixer.order)]
    back = seen @ envs.mixer.rotation
    np.testing.assert_allclose(back[..., :3], roll(make("states", "none", videos), seed=1)[0], atol=1e-5)
    evaluation = make("states", "projection", videos, "evaluation")
    np.testing.assert_array_equal(evaluation.mixer.rotation, envs.mixer.rotation)


@pytest.mark.parametrize("text", ["fog", "copies+fog", "copies+copies", "none+copies", ""])
def test_names_that_are_none_are_refused(text):
    with pytest.raises(DistractorError, match="distractors"):
        parse_distractors(text, list(STATE))


def test_options_out_of_range_or_of_no_distractor_are_named():
    with pytest.raises(DistractorError, match=r"intensity = 1.5"):
        make_distractors(STATE, "noise", 1, DistractorOptions(1.5), "rod_pendulum", "train")
    stray = DistractorOptions(intensities={"camera": 0.5})
    with pytest.raises(DistractorError, match=r"intensities.camera"):
        make_distractors(PIXEL, "colour", 1, stray, "rod_pendulum", "train")
    with pytest.raises(DistractorError, match="drive"):
        make_distractors(STATE, "copies", 1, DistractorOptions(drive="walk"), "rod_pendulum", "train")
    with pytest.raises(DistractorError, match="no such task"):
        make_distractors(STATE, "copies", 1, DistractorOptions(), "unicycle", "train")


def test_an_intensity_of_one_distractor_goes_before_that_of_all():
    options = DistractorOptions(0.2, {"noise": 0.0})
    made = make_distractors(STATE, "copies+noise", 1, options, "rod_pendulum", "train")
    for source in made.values():
        source.seed(0)
        source.restart()
    assert made["copies"].observe().any()
    assert not made["noise"].observe().any()


def test_videos_are_split_and_folders_without_any_are_named(videos, tmp_path):
    def attempt(**options):
        chosen = DistractorOptions(**options)
        return make_distractors(PIXEL, "video", 1, chosen, "rod_pendulum", "train")

    with pytest.raises(DistractorError, match="videos=FOLDER"):
        attempt()
    with pytest.raises(DistractorError, match="no such folder"):
        attempt(videos=str(tmp_path / "nowhere"))
    with pytest.raises(DistractorError, match="no video in it"):
        attempt(videos=str(tmp_path))
    (tmp_path / "a.mp4").write_bytes(b"not a video")
    with pytest.raises(DistractorError, match="one video only"):
        attempt(videos=str(tmp_path))
    (tmp_path / "b.mp4").write_bytes(b"not a video")
    with pytest.raises(DistractorError, match=r"a\.mp4: OpenCV reads no picture"):
        attempt(videos=str(tmp_path))
    attempt(videos=videos, evaluation_videos=videos)


def test_a_task_without_a_video_folder_is_refused_in_one_sentence():
    with pytest.raises(TaskError, match="videos=FOLDER"):
        make_task_factory(TASK, "video", "images")
    assert deepkoco.envs.ENVIRONMENTS


@pytest.mark.parametrize(
    ("text", "known", "needed"), [("copies+camera", STATE, "images"), ("projection", PIXEL, "states")]
)
def test_distractors_of_the_other_observation_say_which_one_they_need(text, known, needed):
    with pytest.raises(DistractorError, match=f"add observation={needed}"):
        parse_distractors(text, list(known))

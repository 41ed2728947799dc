"""Learning from frames: what is stored, what a chunk holds, and a run that is killed and resumed."""

import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.agent import KoopmanPolicy, Trainer, load_policy
from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import Episode, EpisodeBuffer
from deepkoco.agent.checkpoint import CheckpointError, load_checkpoint
from deepkoco.agent.collection import SpaceError, box_sizes, collect_episodes
from deepkoco.agent.policy import ObservationError
from deepkoco.agent.replay_files import read_replay
from deepkoco.koopman import ExportedModel, KoopmanModel, ModelConfig, export_model
from deepkoco.planning import PlannerConfig

sys.path.insert(0, str(Path(__file__).parent))
from small_image_run import EPISODE_STEPS, image_config, make_image_envs

SCRIPT = Path(__file__).parent / "small_image_run.py"
LOW, HIGH = np.array([-2.0]), np.array([2.0])
FRAME = (64, 64, 3)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """An uninterrupted run, which gives no warning."""
    folder = tmp_path_factory.mktemp("images") / "whole"
    folder.mkdir()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Trainer(make_image_envs, image_config(), 7, folder).run()
    return folder


@pytest.fixture
def image_model() -> ExportedModel:
    torch.manual_seed(3)
    config = ModelConfig(2, 0.05, (8,), (8,), frame_features=3, frame_channels=(4, 4))
    return export_model(KoopmanModel((8, 8, 3), 1, config))


def numbered(length: int, number: int) -> Episode:
    """Frames of 2 x 1 pixels that hold (episode, step) in red, action = step, cost = step."""
    frames = torch.zeros(length, 2, 1, 3, dtype=torch.uint8)
    frames[:, 0, 0, 0], frames[:, 1, 0, 0] = number, torch.arange(length)
    step = torch.arange(length, dtype=torch.float32)
    return Episode(frames, step[:, None], step)


@settings(max_examples=25, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 12), min_size=1, max_size=4).filter(lambda n: max(n) > 3),
    history=st.integers(1, 4),
    seed=st.integers(0, 999),
)
def test_chunks_hold_the_frames_of_every_step_and_of_those_before(lengths, history, seed):
    buffer = EpisodeBuffer(history)
    buffer.add([numbered(length, number) for number, length in enumerate(lengths)])
    batch = buffer.sample(3, 6, 3, torch.Generator().manual_seed(seed))
    assert batch.observations.shape == (3, 6 + history - 1, 2, 1, 3)
    for g, start in batch.window_weights.nonzero().tolist():
        for i in range(start, start + 4):
            step = int(batch.costs[g, i])
            seen = batch.observations[g, i : i + history, :, 0, 0]
            assert (seen[:, 0] == seen[0, 0]).all()
            assert seen[:, 1].tolist() == [max(0, step + back) for back in range(1 - history, 1)]


def test_a_buffer_filled_bit_by_bit_draws_what_one_filled_at_once_draws():
    episodes = [numbered(length, number) for number, length in enumerate((9, 5, 12, 7))]
    at_once, bit_by_bit = EpisodeBuffer(3), EpisodeBuffer(3)
    at_once.add(episodes)
    for episode in episodes:
        bit_by_bit.add([episode])
    batches = [b.sample(5, 6, 3, torch.Generator().manual_seed(2)) for b in (at_once, bit_by_bit)]
    assert torch.equal(batches[0].observations, batches[1].observations)
    assert torch.equal(batches[0].costs, batches[1].costs)


def test_replay_keeps_single_bytes_and_adds_without_copying_what_is_there():
    episode = Episode(torch.zeros(200, *FRAME, dtype=torch.uint8), torch.zeros(200, 1), torch.zeros(200))
    buffer = EpisodeBuffer(3)
    buffer.add([episode] * 10)
    # 200 steps of 64 x 64 x 3 bytes of frame and 4 bytes each of action and cost; three times that in stacks
    assert buffer.nbytes == 10 * 200 * (64 * 64 * 3 + 4 + 4)
    assert buffer._episodes[0].observations.data_ptr() == episode.observations.data_ptr()


def test_evaluation_keeps_no_frames_and_costs_the_same():
    agent = VectorAgent(None, PlannerConfig(5), LOW, HIGH, 2)
    envs = make_image_envs(2, 0)
    kept, costs = (collect_episodes(envs, agent, 3, record=record)[1] for record in (True, False))
    assert kept.observations.shape == (EPISODE_STEPS, *FRAME)
    assert kept.observations.dtype == torch.uint8
    assert costs.observations.numel() == 0
    assert torch.equal(kept.costs, costs.costs)


def test_many_environments_on_frames_act_as_one_by_one(image_model):
    frames = np.random.default_rng(0).integers(0, 256, (6, 3, 8, 8, 3), dtype=np.uint8)
    agent = VectorAgent(image_model, PlannerConfig(5), LOW, HIGH, 3)
    policies = [KoopmanPolicy(image_model, PlannerConfig(5), LOW, HIGH) for _ in range(3)]
    for _ in range(2):
        agent.reset()
        for policy in policies:
            policy.reset()
        for batch in frames:
            alone = np.stack([policy.act(o) for policy, o in zip(policies, batch, strict=True)])
            np.testing.assert_allclose(agent.act(batch), alone, atol=1e-5)
    assert np.abs(alone).max() > 1e-3


def test_a_new_episode_forgets_the_frames_of_the_last(image_model):
    frames = np.random.default_rng(0).integers(0, 256, (4, 8, 8, 3), dtype=np.uint8)
    policy = KoopmanPolicy(image_model, PlannerConfig(5), LOW, HIGH)
    first = [policy.act(frame) for frame in frames]
    policy.reset()
    assert [policy.act(frame) for frame in frames] == first


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (np.zeros((8, 9, 3), np.uint8), r"\(8, 9, 3\)"),
        (np.zeros((3, 8, 8, 3), np.uint8), r"\(3, 8, 8, 3\).*one per step"),
        (np.zeros((8, 8, 3)), "float64"),
    ],
)
def test_what_is_no_frame_is_named(image_model, frame, message):
    with pytest.raises(ObservationError, match=message):
        KoopmanPolicy(image_model, PlannerConfig(5), LOW, HIGH).act(frame)


@pytest.mark.parametrize(
    "space",
    [
        spaces.Box(0, 255, (64, 64, 1), np.uint8),
        spaces.Box(0, 1, (64, 64, 3), np.float32),
        spaces.Box(0, 255, (3, 64, 3), np.uint8),
        spaces.Discrete(3),
    ],
)
def test_observations_that_are_neither_states_nor_frames_are_refused(space):
    envs = make_image_envs(1, 0)
    assert box_sizes(envs)[0] == FRAME
    envs.single_observation_space = space
    with pytest.raises(SpaceError, match="observation space"):
        box_sizes(envs)


def test_a_run_on_frames_leaves_finite_losses_and_a_controller(whole):
    rows = pd.read_csv(whole / "metrics.csv")
    assert rows["episodes"].tolist() == [6, 10, 14]
    losses = rows[["loss/linear", "loss/cost_reconstruction", "loss/cost_prediction", "loss/latent_scale"]]
    assert np.isfinite(losses).all(axis=None)
    assert rows["loss/latent_scale"].iloc[-1] > 0.05


def test_control_from_frames_runs_without_torch(whole):
    code = (
        "import sys, numpy; from deepkoco.agent import load_policy\n"
        f"policy = load_policy({str(whole)!r})\n"
        "frame = numpy.zeros((64, 64, 3), numpy.uint8)\n"
        "policy.act(frame); policy.act(frame)\n"
        "assert policy.statistics.failures == 0\n"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.study
def test_a_killed_run_on_frames_ends_bit_for_bit_like_an_uninterrupted_one(whole, tmp_path):
    folder = tmp_path / "killed"
    process = subprocess.Popen([sys.executable, str(SCRIPT), str(folder)])
    deadline = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline:
        # The second iteration's episodes are written, but its checkpoint may be not.
        if (folder / "replay" / "001.pt").exists():
            process.send_signal(signal.SIGKILL)
        time.sleep(0.005)
    assert process.wait() == -signal.SIGKILL
    Trainer(make_image_envs, image_config(), 7, folder).run()

    one, other = (load_checkpoint(f / "checkpoint.pt") for f in (whole, folder))
    for part in ("model", "average"):
        for name, value in one[part].items():
            assert torch.equal(value, other[part][name]), f"{part}.{name}"
    for part in ("sampling", "noise"):
        assert torch.equal(one[part], other[part])
    for a, b in zip(read_replay(whole, 3), read_replay(folder, 3), strict=True):
        assert torch.equal(a.observations, b.observations)
        assert torch.equal(a.actions, b.actions)
    for name in ("model.safetensors", "config.json"):
        assert (whole / "model" / name).read_bytes() == (folder / "model" / name).read_bytes()
    curves = [
        pd.read_csv(f / "metrics.csv").drop(columns=["seconds", "processor_seconds"]) for f in (whole, folder)
    ]
    pd.testing.assert_frame_equal(curves[0], curves[1], check_exact=True)


def test_a_missing_replay_file_is_named(whole, tmp_path):
    (tmp_path / "checkpoint.pt").write_bytes((whole / "checkpoint.pt").read_bytes())
    with pytest.raises(CheckpointError, match=r"000\.pt"):
        Trainer(make_image_envs, image_config(), 7, tmp_path)


def test_the_trained_policy_acts_on_frames_of_the_task(whole):
    policy, envs = load_policy(whole), make_image_envs(1, 0)
    frames, _ = envs.reset(seed=0)
    for _ in range(5):
        frames, *_ = envs.step(policy.act(frames[0])[None])
    assert policy.statistics.failures == 0
    assert policy.statistics.plans == 5

"""Training: the loop, the files it leaves, and resumption after a kill."""

import dataclasses
import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import torch
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from deepkoco.agent import Trainer, TrainingConfig, load_policy
from deepkoco.agent.checkpoint import CheckpointError, load_checkpoint
from deepkoco.agent.config import TrainingConfigError
from deepkoco.koopman import ModelConfig
from deepkoco.planning import PlannerConfig, PlannerConfigError, UnknownSolverError

sys.path.insert(0, str(Path(__file__).parent))
from small_run import make_envs, small_config

SCRIPT = Path(__file__).parent / "small_run.py"


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """An uninterrupted run."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    subprocess.run([sys.executable, str(SCRIPT), str(folder)], check=True)
    return folder


def test_iterations_follow_the_schedule(finished):
    rows = pd.read_csv(finished / "metrics.csv")
    assert rows["episodes"].tolist() == [6, 10, 14, 18, 22, 26, 30]
    # 6 episodes x 40 windows / (2 chunks x 10 windows) = 12 updates an epoch, 40 epochs; later capped at 20
    assert rows["updates"].tolist() == [480 + 20 * i for i in range(7)]
    assert rows["steps"].tolist() == [45 * n for n in rows["episodes"]]
    assert rows["train/noise_variance"].iloc[1] == pytest.approx(0.85 * (1 - 6 / 400))
    assert rows["evaluation/episodes"].tolist() == [2] * 6 + [3]


def test_losses_fall(finished):
    state = load_checkpoint(finished / "checkpoint.pt")
    start = small_config()
    start.first_epochs, start.total_episodes = 1, 6
    folder = finished.parent / "short"
    folder.mkdir()
    first = Trainer(make_envs, start, 7, folder).run()
    last = state["metrics"][0]
    assert last["loss/cost_prediction"] < 0.5 * first["loss/cost_prediction"]
    assert last["loss/cost_reconstruction"] < 0.5 * first["loss/cost_reconstruction"]


def test_the_exported_policy_controls(finished):
    policy = load_policy(finished)
    assert math.isfinite(policy.act([1.0, 0.0, 0.0])[0])
    assert policy.statistics.failures == 0


def test_the_exported_weights_are_the_moving_average(finished):
    average = load_checkpoint(finished / "checkpoint.pt")["average"]
    exported = load_file(finished / "model" / "model.safetensors")
    torch.testing.assert_close(
        exported["encoder.0.weight"],
        average["encoder.network.layers.0.weight"].double(),
        rtol=0,
        atol=0,
    )
    last = load_checkpoint(finished / "checkpoint.pt")["model"]["encoder.network.layers.0.weight"]
    assert not torch.equal(last, exported["encoder.0.weight"].float())


def test_the_history_of_the_eigenvalues_goes_from_the_start_values_to_the_exported_ones(finished):
    rows = pd.read_csv(finished / "eigenvalues.csv")
    exported = load_file(finished / "model" / "model.safetensors")
    assert rows["episodes"].tolist() == [0, 6, 10, 14, 18, 22, 26, 30]
    assert rows[["mu_1", "mu_2", "omega_1", "omega_2"]].iloc[0].tolist() == pytest.approx(
        [0, 0, 0, 2 * math.pi]
    )
    assert rows[["mu_1", "mu_2"]].iloc[-1].tolist() == exported["mu"].tolist()
    assert rows[["omega_1", "omega_2"]].iloc[-1].tolist() == exported["omega"].tolist()


def test_a_finished_run_is_left_as_it_is(finished):
    before = (finished / "model" / "model.safetensors").read_bytes()
    trainer = Trainer(make_envs, small_config(), 7, finished)
    assert trainer.finished
    assert trainer.run()["episodes"] == 30
    assert (finished / "model" / "model.safetensors").read_bytes() == before


@pytest.mark.study
def test_runs_killed_again_and_again_end_bit_for_bit_like_an_uninterrupted_one(finished, tmp_path):
    folder = tmp_path / "killed"
    kills = 0
    for wait in (0.15, 0.5, 0.3):
        process = subprocess.Popen([sys.executable, str(SCRIPT), str(folder)])
        old = (folder / "checkpoint.pt").stat().st_mtime_ns if kills else None
        deadline = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < deadline:
            path = folder / "checkpoint.pt"
            if path.exists() and path.stat().st_mtime_ns != old:
                time.sleep(wait)
                process.send_signal(signal.SIGKILL)
                break
            time.sleep(0.01)
        kills += process.wait() == -signal.SIGKILL
    assert kills >= 2
    subprocess.run([sys.executable, str(SCRIPT), str(folder)], check=True)

    one, other = (load_checkpoint(f / "checkpoint.pt") for f in (finished, folder))
    for part in ("model", "average"):
        for name, value in one[part].items():
            assert torch.equal(value, other[part][name]), f"{part}.{name}"
    for part in ("sampling", "noise"):
        assert torch.equal(one[part], other[part])
    for name in ("model.safetensors", "config.json"):
        assert (finished / "model" / name).read_bytes() == (folder / "model" / name).read_bytes()
    assert (finished / "eigenvalues.csv").read_bytes() == (folder / "eigenvalues.csv").read_bytes()
    curves = [
        pd.read_csv(f / "metrics.csv").drop(columns=["seconds", "processor_seconds"])
        for f in (finished, folder)
    ]
    pd.testing.assert_frame_equal(curves[0], curves[1], check_exact=True)

    events = EventAccumulator(
        str(folder / "tensorboard"), size_guidance={"scalars": 0}, purge_orphaned_data=False
    )
    events.Reload()
    steps = [event.step for event in events.Scalars("evaluation/cost")]
    assert steps == curves[1]["episodes"].tolist()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"chunk_length": 5}, "chunk_length = 5"),
        ({"learning_rate": 0.0}, "learning_rate = 0.0"),
        ({"averaging": 1.0}, "averaging = 1.0"),
        ({"noise_variance": -1.0}, "noise_variance"),
        ({"window_stride": 6}, "give chunk_length = 6"),
        ({"rollout": "thawed"}, "frozen, updated"),
        ({"rollout": "updated"}, "give both or neither"),
        ({"model": ModelConfig(decoder_hidden=(4,))}, "give both or neither"),
        ({"model": ModelConfig(stop_gradients=("A",))}, "takes B and C"),
        ({"model": ModelConfig(cost_rank=0)}, "cost_rank = 0"),
    ],
)
def test_hyper_parameters_out_of_range_are_named_before_work_starts(change, message, tmp_path):
    with pytest.raises(TrainingConfigError, match=message):
        Trainer(make_envs, dataclasses.replace(small_config(), **change), 0, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_planner_that_cannot_work_is_refused_before_training():
    planner = PlannerConfig(5)
    TrainingConfig(horizon=5, planner=planner).check()
    with pytest.raises(PlannerConfigError, match="exceeds the training horizon 4"):
        TrainingConfig(horizon=4, planner=planner).check()
    with pytest.raises(PlannerConfigError, match="dense"):
        TrainingConfig(planner=PlannerConfig(5, form="dense")).check()
    with pytest.raises(UnknownSolverError, match="nope"):
        TrainingConfig(planner=PlannerConfig(5, solver="nope")).check()


def test_a_run_is_not_continued_with_another_seed_or_other_settings(finished):
    with pytest.raises(CheckpointError, match="seed = 7 instead of 8"):
        Trainer(make_envs, small_config(), 8, finished)
    with pytest.raises(CheckpointError, match=r"learning_rate = 0\.001 instead of 0\.002"):
        Trainer(make_envs, dataclasses.replace(small_config(), learning_rate=2e-3), 7, finished)

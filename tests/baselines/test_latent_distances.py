"""What distractors and what the task move in a latent: the three showings, the distances, the command."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from baselines.config import DbcConfig
from baselines.training import BaselineTrainer
from deepkoco.envs.task_factory import TaskConfig
from deepkoco.runs.environments import make_environments
from deepkoco.runs.settings import TrainRunConfig
from experiments.bisimulation_sanity import distances, main, motions, show_states, showings

TASK = TaskConfig("pendulum", "deepkoco/RodPendulum-v0", kwargs={"action_units": "physical"})
CONFIG = DbcConfig(
    total_episodes=1, hidden=8, random_steps=1000, final_evaluation_episodes=1, convolution_channels=(2, 2),
    convolution_strides=(2, 2),
)  # fmt: skip


def run_config(observation="states", distractors="copies"):
    return TrainRunConfig(task=TASK, agent=CONFIG, observation=observation, distractors=distractors)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "dbc"
    folder.mkdir()
    config = run_config()
    OmegaConf.save(OmegaConf.structured(config), folder / "config.yaml", resolve=True)
    BaselineTrainer(make_environments(config), CONFIG, 0, folder).run()
    return folder


def test_each_showing_changes_one_thing():
    run = run_config()
    states = motions(run, 3, 6)
    assert states.shape == (6, 3, 3)
    as_is, others = showings(run, states)
    same = show_states(run, states, 1)
    np.testing.assert_array_equal(as_is, same)
    of_task = [np.isin(as_is[0][0], states[0, 0].astype(np.float32))]
    task = np.all(of_task, axis=0)
    assert task.sum() == 3
    np.testing.assert_array_equal(np.stack(as_is)[..., task], np.stack(others["distractors"])[..., task])
    np.testing.assert_array_equal(np.stack(as_is)[..., ~task], np.stack(others["task"])[..., ~task])
    assert (np.stack(as_is)[..., ~task] != np.stack(others["distractors"])[..., ~task]).all()
    # A latent of the task alone does not move with the distractors.
    moved = distances(lambda shown: np.stack(shown)[..., task], as_is, others)
    assert moved["distractors"] == 0.0
    assert moved["task"] > 0.1


def test_frames_show_other_distractors_and_other_motions():
    run = run_config("images")
    as_is, others = showings(run, motions(run, 2, 3))
    assert as_is[0].shape == (2, 64, 64, 3)
    moved = distances(np.stack, as_is, others)
    assert min(moved.values()) > 0.0


def test_command_writes_table_and_figure(run, tmp_path, capsys):
    assert main([str(run), "--out", str(tmp_path / "out"), "--episodes", "3", "--steps", "4"]) == 0
    table = pd.read_csv(tmp_path / "out" / "latent_distances.csv")
    assert list(table["agent"]) == ["dbc"]
    assert table["ratio"].item() == pytest.approx(
        table["distance_distractors"].item() / table["distance_task"].item(), rel=1e-4
    )
    assert (tmp_path / "out" / "latent_distances.png").stat().st_size > 1000
    assert main([str(run), "--out", str(tmp_path / "out")]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_run_without_distractors_is_refused(run, tmp_path, capsys):
    clean = tmp_path / "clean"
    (clean / "model").mkdir(parents=True)
    OmegaConf.save(OmegaConf.structured(run_config(distractors="none")), clean / "config.yaml", resolve=True)
    assert main([str(clean), "--out", str(tmp_path / "out")]) == 2
    assert "trained without distractors" in capsys.readouterr().err
